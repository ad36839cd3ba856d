#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How far surfaces are from the truth: makes the rows of docs/stages/stereo.md's first table.

  tools/study_surfaces.py [--program vdbcarve] [--backend auto] [--data ../shared/data] [--work FOLDER] [--rows FILE] ROW...

ROW is SCENE:VOXELS:SURFACE. SURFACE: hull, fair, carved (--stereo on --surface hull), led (--stereo on), auto. SCENE: dragon, hand, plain (the
rendered dragon of the test data), or spot, bob, armadillo, bunny, fandisk, bowl, which `synth` photographs in two rings (36 views of 1024 x 768; the
bowl 72); with 1 behind the name, like bob1, in one ring. Prints a row of Markdown each; --rows also appends everything that was measured to FILE, one
JSON object a line. A scene's results share a folder in FOLDER, so that its hull is carved once. Needs Python's standard library.
"""
import argparse
import json
import os
import subprocess
import sys
import time

RENDERED = {
    "dragon": ("scene_dragon_clean", []),
    "hand": ("scene_dragon_handheld", ["--cameras", "transforms_true.json"]),
    "plain": ("scene_dragon_plain_handheld", ["--cameras", "transforms_true.json"]),
}
MODELS = {"spot": "spot_triangulated.obj", "bob": "bob_tri.obj", "armadillo": "armadillo.obj", "bunny": "bunny_hr.obj", "fandisk": "fandisk.obj"}
SURFACES = {
    "hull": ["--surface", "hull"],
    "fair": [],
    "carved": ["--stereo", "on", "--surface", "hull"],
    "led": ["--stereo", "on"],
    "auto": ["--stereo", "auto"],
}


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"study_surfaces: {' '.join(str(part) for part in command)}: exit {done.returncode}\n{done.stderr[-800:]}")
    return done.stdout


def scene_of(name, o):
    """Folder, true mesh, options of reconstruct, whether lengths are millimetres."""
    if name in RENDERED:
        folder, options = RENDERED[name]
        folder = os.path.join(o.data, folder)
        options = [os.path.join(folder, x) if x.endswith(".json") else x for x in options]
        # All three show the same object; its mesh lies beside one of them.
        return folder, os.path.join(o.data, RENDERED["dragon"][0], "gt.ply"), options, True
    base = name.rstrip("1")
    folder = os.path.join(o.work, "scene_" + name)
    if not os.path.exists(os.path.join(folder, "truth.ply")):
        what = base if base == "bowl" else os.path.join(o.data, "meshes", MODELS[base])
        rig = ["--rig", "orbit", "--views", 36] if name != base else ["--rig", "rings", "--views", 72 if base == "bowl" else 36]
        run(o.program, "synth", what, *rig, "--width", 1024, "--height", 768, "--force", "-o", folder)
    return folder, os.path.join(folder, "truth.ply"), [], False


def measure(row, o):
    name, voxels, surface = row.split(":")
    folder, truth, options, millimetres = scene_of(name, o)
    out = os.path.join(o.work, f"out_{name}_{voxels}")
    start = time.time()
    run(o.program, "reconstruct", folder, *options, "-o", out, "--resolution", voxels, "--backend", o.backend, "--color", "none", *SURFACES[surface],
        "--force")
    seconds = time.time() - start
    e = json.loads(run(o.program, "--json", "-", "evaluate", out, "--truth", truth))
    with open(os.path.join(out, "report.json"), encoding="utf-8") as file:
        report = json.load(file)
    views = [v for v in report["views"] if v.get("used", True)]
    unit, scale = ("mm", 1) if millimetres else ("%", 100 / e["truth_size"])
    iou = sum(v["silhouette_iou"] for v in views) / len(views)
    contour = max(v["contour_p95_px"] for v in views)
    print(f"| {name} | {voxels} | {surface} | {100 * e['volume_excess']:.2f} % | {100 * e['truth_lost']:.2f} % | {e['iou']:.3f} | "
          f"{scale * e['mesh_to_truth']['mean']:.3f} {unit} | {scale * e['truth_to_mesh']['mean']:.3f} {unit} | {e['normal_error_mean_deg']:.1f}° | "
          f"{report['mesh']['genus']} | {iou:.4f} | {contour:.2f} px |", flush=True)
    if o.rows:
        kept = {k: report.get(k) for k in ("backend", "fair", "mesh", "slack", "stages", "version")}
        kept["stereo"] = {k: v for k, v in (report.get("stereo") or {}).items() if k != "views"}
        with open(o.rows, "a", encoding="utf-8") as file:
            file.write(json.dumps({"row": row, "seconds": seconds, "evaluation": e, "silhouette_iou": iou, "contour_p95_px": contour, "report": kept}) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    parser.add_argument("--program", default=os.path.join(root, "build/release/vdbcarve"))
    parser.add_argument("--backend", default="auto")
    parser.add_argument("--data", default=os.environ.get("VDBCARVE_TEST_DATA", os.path.join(root, "../shared/data")))
    parser.add_argument("--work", default="surfaces")
    parser.add_argument("--rows")
    parser.add_argument("row", nargs="+")
    o = parser.parse_args()
    os.makedirs(o.work, exist_ok=True)
    for row in o.row:
        name, voxels, surface = (row.split(":") + ["", ""])[:3]
        if name not in RENDERED and name.rstrip("1") not in [*MODELS, "bowl"] or not voxels.isdigit() or surface not in SURFACES:
            parser.error(f"{row}: must be SCENE:VOXELS:SURFACE")
    for row in o.row:
        measure(row, o)


if __name__ == "__main__":
    main()
