#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Measures rendered stars with SEP (Barbary 2016, after SExtractor), which is not ours.

measure_with_sep.py FOLDER

FOLDER/stars.csv has one line a star: frame (FITS), u, v (pixels from 0, v down), electrons. FOLDER/gain.txt holds the electrons a DN.
Writes FOLDER/measured.csv: frame, distance from the true place (px), flux over the true one, S/N; a star that was not
found has an empty distance.
"""
import csv
import pathlib
import sys
from collections import defaultdict

import numpy
import sep
from astropy.io import fits

APERTURE_PX = 6.0


def main():
    folder = pathlib.Path(sys.argv[1])
    gain = float((folder / "gain.txt").read_text())
    stars = defaultdict(list)
    with open(folder / "stars.csv", newline="") as f:
        for frame, u, v, electrons in csv.reader(f):
            stars[frame].append((float(u), float(v), float(electrons)))
    with open(folder / "measured.csv", "w", newline="") as f:
        out = csv.writer(f)
        for frame, true in stars.items():
            # The first row of a FITS file is the bottom of the picture.
            pixels = numpy.ascontiguousarray(fits.getdata(folder / frame)[::-1].astype(numpy.float32))
            background = sep.Background(pixels, bw=64, bh=64)
            light = pixels - background
            found = sep.extract(light, 5.0, err=background.globalrms, minarea=4)
            x, y, _ = sep.winpos(light, found["x"], found["y"], numpy.full(len(found), 1.5))
            flux, error, _ = sep.sum_circle(light, x, y, APERTURE_PX, err=background.globalrms, gain=gain)
            for u, v, electrons in true:
                distance = numpy.hypot(x - u, y - v)
                nearest = int(numpy.argmin(distance))
                if distance[nearest] > 2.0:
                    out.writerow([frame, "", "", ""])
                    continue
                out.writerow([frame, distance[nearest], flux[nearest] * gain / electrons, flux[nearest] / error[nearest]])


if __name__ == "__main__":
    main()
