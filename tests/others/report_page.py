# SPDX-License-Identifier: Apache-2.0
"""The report's page in a browser: report_page.py CHROMIUM PAGE FOLDER. Wide and narrow, its console must be empty, nothing may stick out sideways, and the 3-D view must show the model: where its
picture (the poster) is taken away, its pixels still are not all background, and turn with the camera."""
import re
import struct
import subprocess
import sys
import zlib
from pathlib import Path

chromium, page, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])


def pixels(file):
    """Rows of (r, g, b) of an 8-bit PNG."""
    data, at, packed, size, channels = file.read_bytes(), 8, b"", None, None
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            size, channels = struct.unpack(">II", body[:8]), {2: 3, 6: 4}[body[9]]
        elif kind == b"IDAT":
            packed += body
        at += 12 + length
    raw, rows, width = zlib.decompress(packed), [], size[0] * channels
    before = bytearray(width)
    for y in range(size[1]):
        way, row = raw[y * (width + 1)], bytearray(raw[y * (width + 1) + 1:(y + 1) * (width + 1)])
        for i in range(width):
            a = row[i - channels] if i >= channels else 0
            b = before[i]
            c = before[i - channels] if i >= channels else 0
            if way == 1:
                row[i] = (row[i] + a) & 255
            elif way == 2:
                row[i] = (row[i] + b) & 255
            elif way == 3:
                row[i] = (row[i] + (a + b) // 2) & 255
            elif way == 4:
                p = a + b - c
                near = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))
                row[i] = (row[i] + near[2]) & 255
        rows.append([tuple(row[x:x + 3]) for x in range(0, width, channels)])
        before = row
    return rows


def shot(html, name, width, height, budget_ms=20000):
    out = folder / f"{name}.png"
    said = subprocess.run([chromium, "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", f"--virtual-time-budget={budget_ms}", "--enable-logging=stderr", "--hide-scrollbars",
                           f"--user-data-dir={folder}/browser", f"--window-size={width},{height}", f"--screenshot={out}", html.resolve().as_uri()], capture_output=True, text=True, timeout=300)
    console = [line for line in said.stderr.splitlines() if "CONSOLE" in line]
    assert not console, console[:3]
    assert out.exists(), said.stderr[-500:]
    return pixels(out)


text = page.read_text()
assert "model-viewer" in text, "built without the viewer"
bare = re.sub(r' poster="data:[^"]*"', "", text)
assert bare != text


def drawn_pixels(view):
    background = view[len(view) // 2][2]
    return sum(max(abs(p[c] - background[c]) for c in range(3)) > 12 for row in view for p in row)


for name, width, height in (("wide", 1200, 1000), ("narrow", 400, 900)):
    # The viewer alone, on a plain page: all that is seen is drawn by it.
    views = []
    for turn in ("0deg 75deg auto", "90deg 75deg auto"):
        viewer = re.search(r"<model-viewer camera-controls.*?</model-viewer>", bare, re.S).group(0).replace("<model-viewer", f'<model-viewer camera-orbit="{turn}"')
        head = bare[:bare.index("</head><body>")] + "</head>"
        alone = folder / f"{name}_model.html"
        alone.write_text(f'{head}<body style="background:#fff">{viewer}</body></html>')
        # The browser's clock runs on while a busy machine is still decoding the model: then it is given more of it.
        for budget_ms in (20000, 60000, 180000):
            view = shot(alone, f"{name}_model_{len(views)}", width, height, budget_ms)
            if drawn_pixels(view) > 0.02 * width * height:
                break
        views.append(view)
    drawn = [drawn_pixels(view) for view in views]
    moved = sum(max(abs(a[c] - b[c]) for c in range(3)) > 12 for x, y in zip(*views) for a, b in zip(x, y))
    colors = len({p for row in views[0] for p in row})
    print(f"{name}: {drawn} pixels drawn, {moved} of them change as it turns, {colors} colours")
    assert min(drawn) > 0.02 * width * height, "the 3-D view is empty"
    assert moved > 0.25 * min(drawn), "the model does not turn"
    assert colors > 200, "the model is not shaded"
    # The whole page, as it is.
    rows = shot(page, name, width, height)
    assert len(rows[0]) == width
print("the page shows the model")
