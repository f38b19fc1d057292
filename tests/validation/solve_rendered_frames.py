#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Solves frames with programs that are not ours: stars by SEP, plate solution by astrometry.net, WCS by astropy.

solve_rendered_frames.py FOLDER

FOLDER/frames.csv has one line a frame: file, RA and Dec of the image centre (degrees), horizontal field (degrees).
Writes FOLDER/solved.csv: file, solved (0 or 1), distance in pixels between the image centre and the place where the
solution puts the given RA and Dec.
"""
import concurrent.futures
import csv
import pathlib
import subprocess
import sys
import warnings

import numpy
import sep
from astropy.io import fits
from astropy.wcs import WCS

warnings.simplefilter("ignore")


def extract(frame, table):
    pixels = fits.getdata(frame).astype(numpy.float32)
    background = sep.Background(pixels)
    found = sep.extract(pixels - background, 5.0, err=background.globalrms, minarea=4)
    found = found[numpy.argsort(-found["flux"])][:100]
    columns = [fits.Column(name=n, format="E", array=a)
               for n, a in (("X", found["x"] + 1.0), ("Y", found["y"] + 1.0), ("FLUX", found["flux"]))]
    fits.BinTableHDU.from_columns(columns).writeto(table, overwrite=True)
    return pixels.shape


def solve(folder, name, ra, dec, field):
    frame = folder / name
    table = frame.with_suffix(".xyls")
    height, width = extract(frame, table)
    subprocess.run(
        ["solve-field", "--no-plots", "--overwrite", "--dir", str(folder), "--width", str(width), "--height", str(height),
         "--x-column", "X", "--y-column", "Y", "--sort-column", "FLUX", "--scale-units", "degwidth",
         "--scale-low", str(0.8 * field), "--scale-high", str(1.2 * field), "--crpix-center", "--tweak-order", "1",
         "--cpulimit", "15", "--new-fits", "none", "--solved", "none", "--match", "none", "--rdls", "none",
         "--corr", "none", "--index-xyls", "none", "--axy", str(frame.with_suffix(".axy")), str(table)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=60, check=False)
    solution = frame.with_suffix(".wcs")
    if not solution.exists():
        return name, 0, ""
    x, y = WCS(fits.getheader(solution)).all_world2pix(ra, dec, 0)
    return name, 1, float(numpy.hypot(x - 0.5 * (width - 1), y - 0.5 * (height - 1)))


def main():
    folder = pathlib.Path(sys.argv[1])
    with open(folder / "frames.csv", newline="") as f:
        frames = [(name, float(ra), float(dec), float(field)) for name, ra, dec, field in csv.reader(f)]
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda frame: solve(folder, *frame), frames))
    with open(folder / "solved.csv", "w", newline="") as f:
        csv.writer(f).writerows(results)


main()
