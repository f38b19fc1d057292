#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Windowed centroids of SEP (Barbary 2016, after SExtractor), which is not ours, on frames that we measure too.

centroids_with_sep.py FOLDER GAIN

FOLDER/stars.csv has one line a star: frame (FITS), u, v (pixels from 0, v down). Writes FOLDER/measured.csv: frame, u, v
as in stars.csv, and where SEP saw the star (empty where it did not). The window is as SEP's manual advises: a Gaussian
of 2/2.35 of the radius that holds half of the light.
"""
import csv
import pathlib
import sys
from collections import defaultdict

import numpy
import sep
from astropy.io import fits


def main():
    folder, gain = pathlib.Path(sys.argv[1]), float(sys.argv[2])
    stars = defaultdict(list)
    with open(folder / "stars.csv", newline="") as f:
        for frame, u, v in csv.reader(f):
            stars[frame].append((u, v))
    with open(folder / "measured.csv", "w", newline="") as f:
        out = csv.writer(f)
        for frame, true in stars.items():
            # The first row of a FITS file is the bottom of the picture.
            pixels = numpy.ascontiguousarray(fits.getdata(folder / frame)[::-1].astype(numpy.float32))
            # A background for the whole frame: SEP's mesh takes medians, which half a DN of noise makes whole numbers.
            light = pixels - numpy.mean(pixels[numpy.abs(pixels - numpy.median(pixels)) < 4.0])
            noise = float(numpy.std(light[numpy.abs(light) < 4.0]))
            found = sep.extract(light, 5.0, err=noise, minarea=1, gain=gain)
            half, _ = sep.flux_radius(light, found["x"], found["y"], numpy.full(len(found), 8.0), 0.5, subpix=5)
            x, y, _ = sep.winpos(light, found["x"], found["y"], 2.0 / 2.35 * numpy.clip(half, 0.5, 4.0))
            for u, v in true:
                distance = numpy.hypot(x - float(u), y - float(v))
                nearest = int(numpy.argmin(distance))
                seen = distance[nearest] < 2.0
                out.writerow([frame, u, v, x[nearest] if seen else "", y[nearest] if seen else ""])


if __name__ == "__main__":
    main()
