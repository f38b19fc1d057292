#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Makes data/de405_2000_2050.bsp (SPK type 2) from Debian's casacore-data-jpl-de405.

    tools/build_ephemeris.py [--table FILE] [--out FILE]

The Chebyshev coefficients of JPL's DE405 are copied as they are; only the Moon is split in two: the geocentric Moon of
the table times mu/(1+mu) is the Moon, and times -1/(1+mu) the Earth, both with respect to the Earth-Moon barycentre.
The same input gives the same bytes. docs/data.md tells the provenance.
"""

import argparse
import hashlib
import pathlib
import struct
import sys

import numpy as np

TABLE = "/usr/share/casacore/data/ephemerides/DE405/table.f0i"
FIRST_MJD = 36912.0  # of record 0, TDB
RECORD_DAYS = 32
RECORD_COUNT = 1143
RECORD_HEAD = np.array([1, 1, 1018], dtype="<u4")
RECORD_BYTES = 8160
TABLE_HEAD_BYTES = 16
EARTH_MOON_MASS_RATIO = 81.30056  # DE405
FIRST_COVERED_MJD = 51527.0  # 1999-12-15
LAST_COVERED_MJD = 70182.0  # 2051-01-15
J2000_MJD = 51544.5

# (target, centre, name, start, coefficients, intervals a record, factor); starts are 1-based and count two dates that
# the table leaves out.
MU = EARTH_MOON_MASS_RATIO
SERIES = [
    (1, 0, "MERCURY BARYCENTER", 3, 14, 4, 1.0),
    (2, 0, "VENUS BARYCENTER", 171, 10, 2, 1.0),
    (3, 0, "EARTH-MOON BARYCENTER", 231, 13, 2, 1.0),
    (4, 0, "MARS BARYCENTER", 309, 11, 1, 1.0),
    (5, 0, "JUPITER BARYCENTER", 342, 8, 1, 1.0),
    (6, 0, "SATURN BARYCENTER", 366, 7, 1, 1.0),
    (7, 0, "URANUS BARYCENTER", 387, 6, 1, 1.0),
    (8, 0, "NEPTUNE BARYCENTER", 405, 6, 1, 1.0),
    (9, 0, "PLUTO BARYCENTER", 423, 6, 1, 1.0),
    (10, 0, "SUN", 753, 11, 2, 1.0),
    (301, 3, "MOON", 441, 13, 8, MU / (1.0 + MU)),
    (399, 3, "EARTH", 441, 13, 8, -1.0 / (1.0 + MU)),
]
# Without moons, centre and barycentre are one.
SAME_PLACE = [(199, 1, "MERCURY"), (299, 2, "VENUS")]

COMMENT = """\
Sun, Moon, planets and Pluto, 2000 to 2050: JPL DE405 (Standish 1998, JPL IOM 312.F-98-048), public domain.

Made by tools/build_ephemeris.py of astronav from Debian's casacore-data-jpl-de405 (table.f0i, SHA-256
{sha}).
The Chebyshev coefficients are those of DE405, unchanged. Moon and Earth with respect to the Earth-Moon
barycentre are DE405's geocentric Moon times mu/(1+mu) and -1/(1+mu), mu = {mu}.
Mercury (199) and Venus (299) have no moons and stand in their barycentres.
No gravitational parameters belong to this file.
"""


def read_table(path):
    """(records, 1018) coefficients and the MJD of the first one kept."""
    raw = pathlib.Path(path).read_bytes()
    first = int((FIRST_COVERED_MJD - FIRST_MJD) // RECORD_DAYS)
    last = int((LAST_COVERED_MJD - FIRST_MJD) // RECORD_DAYS)
    if last >= RECORD_COUNT or len(raw) < TABLE_HEAD_BYTES + RECORD_BYTES * (last + 1):
        sys.exit(f"{path}: {len(raw)} bytes do not hold record {last}")
    rows = []
    for i in range(first, last + 1):
        at = TABLE_HEAD_BYTES + RECORD_BYTES * i
        if not np.array_equal(np.frombuffer(raw, "<u4", 3, at), RECORD_HEAD):
            sys.exit(f"{path}: byte {at}: record {i} does not begin with 1, 1, 1018")
        rows.append(np.frombuffer(raw, "<f8", 1018, at + 12))
    table = np.array(rows)
    if not np.isfinite(table).all():
        sys.exit(f"{path}: a coefficient is not a number")
    return table, FIRST_MJD + RECORD_DAYS * first, hashlib.sha256(raw).hexdigest()


def seconds(mjd):
    return (mjd - J2000_MJD) * 86400.0


def type2(coefficients, begin_s, interval_s):
    """SPK type 2 from (records, 3 * n) coefficients."""
    count = len(coefficients)
    middle = begin_s + (np.arange(count) + 0.5) * interval_s
    radius = np.full(count, interval_s / 2.0)
    records = np.column_stack([middle, radius, coefficients])
    directory = [begin_s, interval_s, records.shape[1], count]
    return np.concatenate([records.ravel(), directory]).astype("<f8").tobytes()


def segments(table, first_mjd):
    begin = seconds(first_mjd)
    end = seconds(first_mjd + RECORD_DAYS * len(table))
    for target, centre, name, start, n, intervals, factor in SERIES:
        offset = start - 3
        block = table[:, offset : offset + 3 * n * intervals].reshape(-1, 3 * n) * factor
        yield target, centre, name, begin, end, type2(block, begin, RECORD_DAYS * 86400.0 / intervals)
    for target, centre, name in SAME_PLACE:
        yield target, centre, name, begin, end, type2(np.zeros((1, 6)), begin, end - begin)


def daf(parts, comment):
    """A little-endian DAF/SPK file: file record, comments, one summary record with its names, then the data."""
    text = comment.replace("\n", "\0").encode("ascii") + b"\x04"
    comments = [text[i : i + 1000].ljust(1024, b"\0") for i in range(0, len(text), 1000)]
    summary_record = 2 + len(comments)
    word = (summary_record + 1) * 128 + 1
    summaries, names, data = b"", b"", b""
    for target, centre, name, begin, end, body in parts:
        last = word + len(body) // 8 - 1
        summaries += struct.pack("<ddiiiiii", begin, end, target, centre, 1, 2, word, last)
        names += f"DE405 {name}".ljust(40).encode("ascii")
        data += body
        word = last + 1
    count = len(summaries) // 40
    check = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"
    head = b"DAF/SPK " + struct.pack("<ii", 2, 6) + b"DE405 2000-2050, astronav".ljust(60)
    head += struct.pack("<iii", summary_record, summary_record, word) + b"LTL-IEEE"
    head = head.ljust(699, b"\0") + check
    out = head.ljust(1024, b"\0") + b"".join(comments)
    out += (struct.pack("<ddd", 0, 0, count) + summaries).ljust(1024, b"\0") + names.ljust(1024)
    out += data
    return out.ljust((len(out) + 1023) // 1024 * 1024, b"\0")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", default=TABLE, help=f"DE405 of casacore (default {TABLE})")
    root = pathlib.Path(__file__).resolve().parent.parent
    parser.add_argument("--out", default=root / "data" / "de405_2000_2050.bsp", type=pathlib.Path)
    arguments = parser.parse_args()
    if not pathlib.Path(arguments.table).exists():
        sys.exit(f"{arguments.table} is not there: apt-get install casacore-data-jpl-de405")
    table, first_mjd, sha = read_table(arguments.table)
    out = daf(segments(table, first_mjd), COMMENT.format(sha=sha, mu=MU))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_bytes(out)
    digest = hashlib.sha256(out).hexdigest()
    arguments.out.with_name(arguments.out.name + ".sha256").write_text(f"{digest}  {arguments.out.name}\n")
    last_mjd = first_mjd + RECORD_DAYS * len(table)
    print(f"{arguments.out}: {len(out)} bytes, MJD {first_mjd:.0f} to {last_mjd:.0f} TDB, {len(table)} records, {digest}")


if __name__ == "__main__":
    main()
