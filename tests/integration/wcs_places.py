#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Puts the sources of a truth file through the world coordinates of the frame, as astropy reads them.

wcs_places.py FRAME.fits TRUTH.json PLACES.csv

PLACES.csv gets one line a source: u and v (pixels, row 0 at the top) by the truth, u and v by the WCS from the truth's RA
and Dec, and the distance on the sky (arcsec) between that RA and Dec and where the WCS puts the truth's pixel.
"""
import csv
import json
import sys
import warnings

import numpy
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS

warnings.simplefilter("error")  # a header that astropy has to mend is not good enough
warnings.filterwarnings("ignore", message="'datfix' made the change 'Set MJD")  # dates added as MJD are no mending

with open(sys.argv[2]) as file:
    sources = json.load(file)["sources"]
u, v, ra, dec = (numpy.array([s[k] for s in sources]) for k in ("u_px", "v_px", "ra_deg", "dec_deg"))
header = fits.getheader(sys.argv[1])
height = header["NAXIS2"]
wcs = WCS(header)
x, y = wcs.all_world2pix(ra, dec, 0, tolerance=1e-8)
there = SkyCoord(*wcs.all_pix2world(u, height - 1 - v, 0), unit="deg")
apart = there.separation(SkyCoord(ra, dec, unit="deg")).arcsec
with open(sys.argv[3], "w", newline="") as file:
    csv.writer(file).writerows(zip(u, v, x, height - 1 - y, apart))
