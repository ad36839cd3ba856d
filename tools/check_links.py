#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the links of the documents: tools/check_links.py [FOLDER]

Every relative link and picture of every tracked *.md has to resolve, its #heading included, and every page that any text file
names (docs/….md, README.md …) has to exist. Prints what does not, one line each, and exits with 1.
Needs Python's standard library and git.
"""
import os
import re
import subprocess
import sys
import urllib.parse

PAGE_SUFFIX = ".md"
# Files whose comments may name pages.
SOURCE_SUFFIXES = (".h", ".in", ".cpp", ".cu", ".cuh", ".sh", ".py", ".js", ".cmake", ".txt", ".json", ".yml")
SOURCE_NAMES = (".ci/run",)
# [text](target) and ![text](target "title"); the target has no spaces unless it stands in <>.
LINK = re.compile(r"\]\(\s*(?:<([^>]*)>|([^()\s]*(?:\([^()\s]*\)[^()\s]*)*))(?:\s+\"[^\"]*\")?\s*\)")
REFERENCE = re.compile(r"^ {0,3}\[[^\]]+\]:\s*(\S+)")
HTML = re.compile(r"<(?:img|a)\b[^>]*?\b(?:src|href)=\"([^\"]*)\"", re.IGNORECASE)
SCHEME = re.compile(r"^[a-z][a-z0-9+.-]*:", re.IGNORECASE)
FENCE = re.compile(r"^ {0,3}(```+|~~~+)")
CODE_SPAN = re.compile(r"(`+)(?:(?!\1).)+?\1")
HEADING = re.compile(r"^ {0,3}#{1,6}\s+(.*?)\s*#*\s*$")
# A page by its path from the top folder, in a comment or in prose.
NAMED_PAGE = re.compile(r"(?<![\w/.-])((?:docs|src|cuda|tests|tools|data|examples)/[\w./-]*\.md|(?:README|BENCHMARKS|CONTRIBUTING|CHANGELOG)\.md)\b")


def tracked_files(root):
    out = subprocess.run(["git", "-C", root, "ls-files", "-z"], check=True, capture_output=True).stdout
    return sorted(f for f in out.decode().split("\0") if f and os.path.isfile(os.path.join(root, f)))


def prose_lines(text):
    """Numbered lines outside of code. Of indented blocks only those without links are left out: a list's continued paragraph looks the same."""
    fence = None
    after_blank = True
    for number, line in enumerate(text.split("\n"), 1):
        mark = FENCE.match(line)
        if fence:
            if mark and mark.group(1).startswith(fence):
                fence = None
            continue
        if mark:
            fence = mark.group(1)
            continue
        if line.startswith("    ") and after_blank and not re.search(r"\]\(", line):
            continue
        after_blank = not line.strip()
        yield number, line


def anchors_of(path):
    """The fragments that a page's headings have on the web."""
    found, seen = set(), {}
    with open(path, encoding="utf-8") as page:
        for _, line in prose_lines(page.read()):
            heading = HEADING.match(line)
            if not heading:
                continue
            name = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading.group(1)).replace("`", "").replace("*", "")
            name = re.sub(r"[^\w\- ]", "", name.lower()).replace(" ", "-")
            count = seen.get(name, 0)
            seen[name] = count + 1
            found.add(f"{name}-{count}" if count else name)
    return found


def targets_of(text):
    """(line number, target) of each link and picture."""
    for number, line in prose_lines(text):
        line = CODE_SPAN.sub(lambda m: " " * len(m.group(0)), line)
        for match in LINK.finditer(line):
            yield number, match.group(1) or match.group(2) or ""
        for match in HTML.finditer(line):
            yield number, match.group(1)
        reference = REFERENCE.match(line)
        if reference:
            yield number, reference.group(1)


def check_page(root, page, faults):
    """Returns how many links were looked at."""
    count = 0
    with open(os.path.join(root, page), encoding="utf-8") as file:
        text = file.read()
    for number, target in targets_of(text):
        if SCHEME.match(target) or target.startswith("//"):
            continue
        count += 1
        path, _, fragment = urllib.parse.unquote(target).partition("#")
        if not path and not fragment:
            faults.append(f"{page}:{number}: an empty link")
            continue
        there = os.path.normpath(os.path.join(root, os.path.dirname(page), path) if path else os.path.join(root, page))
        if path.startswith("/") or os.path.relpath(there, root).startswith(".."):
            faults.append(f"{page}:{number}: {target} leads out of the repository")
        elif not os.path.exists(there):
            faults.append(f"{page}:{number}: {target} is not there")
        elif fragment and there.endswith(PAGE_SUFFIX) and fragment not in anchors_of(there):
            faults.append(f"{page}:{number}: {target}: the page has no such heading")
    return count


def check_names(root, source, faults):
    """Returns how many pages it names."""
    count = 0
    with open(os.path.join(root, source), encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            for match in NAMED_PAGE.finditer(line):
                count += 1
                if not os.path.isfile(os.path.join(root, match.group(1))):
                    faults.append(f"{source}:{number}: names {match.group(1)}, which is not there")
    return count


def main():
    if len(sys.argv) > 2:
        sys.exit("usage: tools/check_links.py [FOLDER]")
    root = os.path.abspath(sys.argv[1] if len(sys.argv) == 2 else os.path.join(os.path.dirname(__file__), ".."))
    faults, links, named, pages = [], 0, 0, 0
    for file in tracked_files(root):
        if file.endswith(PAGE_SUFFIX):
            pages += 1
            links += check_page(root, file, faults)
        if file.endswith((PAGE_SUFFIX, *SOURCE_SUFFIXES)) or file in SOURCE_NAMES:
            named += check_names(root, file, faults)
    for fault in faults:
        print(fault)
    print(f"check_links: {pages} pages with {links} relative links, {named} pages named by path; {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
