#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the walls of docs/architecture.md from the #include lines: who may include whom, and which third-party header
belongs to which folder. Prints each breach as file:line and exits 1 if there is any; --self-test checks the checker."""
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent / "src"

# Folder -> folders of this project that it may include (itself always). The order is the order of the house.
F = "foundation/"
M = "models/"
FOUNDATION = [F + n for n in ("base", "files", "math", "time", "image", "raster")]
FOUNDATION_FLIGHT = [F + n for n in ("base", "math", "time", "image")]
MODELS = [M + n for n in ("ephemeris", "aberration", "stars", "photometry", "camera", "camera_file", "oem")]
MODELS_FLIGHT = [M + n for n in ("ephemeris", "aberration", "stars", "photometry", "camera")]
SIMULATOR = ["simulator/" + n for n in ("sky", "render", "dynamics", "trajectory", "transfer", "motion")]
ONBOARD = ["onboard/" + n for n in ("vision", "navigation", "attitude", "executive")]
VERIFICATION = ["verification/" + n for n in ("scenario", "loop", "campaign", "opensky", "report")]

MAY_INCLUDE = {
    F + "base": [],
    F + "files": [F + "base"],
    F + "math": [F + "base"],
    F + "time": [F + "base", F + "math"],
    F + "image": [F + "base", F + "math"],
    F + "raster": [F + "base", F + "files", F + "math", F + "image"],
    M + "ephemeris": FOUNDATION_FLIGHT,
    M + "aberration": FOUNDATION_FLIGHT,
    M + "stars": FOUNDATION_FLIGHT,
    M + "camera": FOUNDATION_FLIGHT,
    M + "photometry": FOUNDATION_FLIGHT + [M + n for n in ("ephemeris", "aberration", "stars", "camera")],
    M + "camera_file": FOUNDATION + [M + "camera"],
    M + "oem": FOUNDATION + [M + "ephemeris"],
    "simulator/sky": FOUNDATION + MODELS,
    "simulator/render": FOUNDATION + MODELS + ["simulator/sky"],
    "simulator/dynamics": FOUNDATION + MODELS,
    "simulator/trajectory": FOUNDATION + MODELS + ["simulator/dynamics"],
    "simulator/transfer": FOUNDATION + MODELS + ["simulator/dynamics", "simulator/trajectory"],
    "simulator/motion": [F + "base", F + "math", F + "time"],
    # Someone else's flight software can use the server alone.
    "simulator/server": FOUNDATION + MODELS + ["simulator/sky", "simulator/render"],
    # A measurement is a plain struct: navigation knows nothing of images.
    "onboard/navigation": [f for f in FOUNDATION_FLIGHT if f != F + "image"] + MODELS_FLIGHT,
    "onboard/attitude": [F + "base", F + "math", F + "time"],
    "onboard/vision": FOUNDATION_FLIGHT + MODELS_FLIGHT,
    "onboard/executive": FOUNDATION_FLIGHT + MODELS_FLIGHT + ["onboard/vision", "onboard/navigation", "onboard/attitude"],
    "verification/scenario": FOUNDATION + MODELS,
    "verification/loop": FOUNDATION + MODELS + SIMULATOR + ONBOARD + ["verification/scenario"],
    "verification/campaign": FOUNDATION + MODELS + SIMULATOR + ONBOARD + ["verification/scenario", "verification/loop"],
    "verification/opensky": FOUNDATION + MODELS + SIMULATOR + ONBOARD,
    "verification/report": FOUNDATION + MODELS + SIMULATOR + ONBOARD
    + ["verification/scenario", "verification/loop", "verification/campaign"],
    "cli": FOUNDATION + MODELS + SIMULATOR + ["simulator/server"] + ONBOARD + VERIFICATION,
}

# Third-party header -> the folders that may see it. Tests (*_test.cpp, *_for_tests.h) may include more.
PRIVATE_HEADERS = [
    (r"(fitsio|png|tiffio|tiff|jpeglib)\.h$", [F + "raster"]),
    (r"toml\+\+", ["verification/scenario", M + "camera_file"]),
    (r"nlohmann/", ["cli", "simulator/server", "verification/loop", "verification/campaign", "verification/report"]),
    (r"^erfa(m)?\.h$", [F + "time", M + "aberration", M + "ephemeris"]),
    (r"^boost/numeric/odeint", ["simulator/dynamics"]),
    (r"^asio", ["simulator/server"]),
    (r"^SDL", ["simulator/devices"]),
    (r"^(ceres|glog)/", ["verification/opensky"]),
    (r"^CLI/", ["cli"]),
    (r"^(fstream|filesystem|iostream|thread|exception|sys/.*|unistd\.h)$",
     [F + "base", F + "files", F + "raster", M + "camera_file", "simulator", "verification", "cli"]),
]

INCLUDE = re.compile(r'^\s*#\s*include\s+(?:"([^"]+)"|<([^>]+)>)')


def breaches_of(folder, path, text):
    """Yields (line, sentence) for each breach in one file's text."""
    test = path.endswith(("_test.cpp", "_for_tests.h"))
    for number, line in enumerate(text.splitlines(), 1):
        match = INCLUDE.match(line)
        if not match:
            continue
        quoted, angled = match.groups()
        if quoted:
            target = str(Path(quoted).parent)
            if quoted.endswith("_for_tests.h") and not test:
                yield number, f'"{quoted}" is for tests only'
                continue
            if target == folder or (test and target == "support"):
                continue
            if not (ROOT / quoted).exists():
                yield number, f'"{quoted}" is not a header of this project, written from src/'
                continue
            allowed = MAY_INCLUDE[folder]
            if test:  # a test may read files, but never reach over the wall
                allowed = allowed + [F + "files", F + "raster", M + "camera_file"]
            if target not in allowed:
                yield number, f"{folder} must not include {target}"
        elif not test:
            for pattern, folders in PRIVATE_HEADERS:
                if re.search(pattern, angled) and not any(folder == f or folder.startswith(f + "/") for f in folders):
                    yield number, f"<{angled}> is private to {', '.join(folders)}"


def check():
    count = 0
    for file in sorted(ROOT.rglob("*")):
        if file.suffix not in (".h", ".cpp"):
            continue
        folder = str(file.parent.relative_to(ROOT))
        if folder not in MAY_INCLUDE:
            print(f"{file.relative_to(ROOT.parent)}:1: folder {folder} is not in tools/check_includes.py")
            count += 1
            continue
        for line, sentence in breaches_of(folder, str(file), file.read_text()):
            print(f"{file.relative_to(ROOT.parent)}:{line}: {sentence}")
            count += 1
    return count


def self_test():
    """A checker that cannot fail is a defect: each wall is breached once, and must be seen."""
    cases = [
        ("onboard/vision", '#include "simulator/sky/sky.h"', "simulator/sky"),
        ("simulator/render", '#include "onboard/vision/types.h"', "onboard/vision"),
        ("onboard/navigation", '#include "foundation/image/image.h"', "foundation/image"),
        ("onboard/navigation", '#include "onboard/vision/types.h"', "onboard/vision"),
        ("onboard/executive", '#include "foundation/files/mapped_file.h"', "foundation/files"),
        ("foundation/base", '#include "models/camera/camera.h"', "models/camera"),
        ("models/camera", "#include <toml++/toml.h>", "toml++"),
        ("onboard/navigation", "#include <fstream>", "fstream"),
        ("simulator/sky", "#include <nlohmann/json.hpp>", "nlohmann"),
    ]
    for folder, line, expected in cases:
        found = [s for _, s in breaches_of(folder, "x.cpp", line)]
        assert any(expected in s for s in found), f"{folder}: {line} was let through"
    # Tests, and the headers that only they include, may read files and see any library; over the wall they never reach.
    for name in ("x_test.cpp", "x_for_tests.h"):
        assert not list(breaches_of("onboard/vision", name, '#include "foundation/files/mapped_file.h"\n#include <fstream>'))
        assert list(breaches_of("onboard/vision", name, '#include "simulator/sky/sky.h"')), f"{name}: the wall was open"
    assert list(breaches_of("onboard/navigation", "x.cpp", '#include "onboard/navigation/arc_for_tests.h"'))
    assert not list(breaches_of("onboard/navigation", "x_test.cpp", '#include "onboard/navigation/arc_for_tests.h"'))
    assert not list(breaches_of("onboard/vision", "x.cpp", '#include "models/camera/camera.h"\n#include <cmath>'))


if __name__ == "__main__":
    self_test()
    found = check()
    if found == 0:
        print("include walls: no breach")
    sys.exit(1 if found else 0)
