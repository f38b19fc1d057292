#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Builds data/hipparcos.stars (format: docs/formats.md, provenance: docs/data.md).

    apt-get install stellarium-data python3-numpy        # Debian 12: stellarium-data 0.22.2
    npm pack d3-celestial@0.7.35 && tar xzf d3-celestial-0.7.35.tgz
    tools/build_star_catalogue.py --d3 package/data/stars.14.json --out data/hipparcos.stars

Places, proper motions and parallaxes come from the first source; V and B-V (to 0.01) and the places where the first is
known to be wrong come from the second. Double stars closer than 10 arcsec become one star with the light of all
components at their centre of light; farther components become stars of their own. The same input gives the same bytes.
"""
import argparse
import hashlib
import json
import pathlib
import struct
import zlib

import numpy as np

SCALE = 2**31 - 1
UNKNOWN_COLOUR = -32768
CHORD_OF_HALF_ARCSECOND = 0.5 / 206264.80625
LEVEL_SIDE = [0.7639320, 0.3819660, 0.1909830]  # of the tangent-plane coordinates, by level
FIRST_MAGNITUDE = [-2.0, 6.0, 7.5]
# Colour indices that stand for "unknown": of 1,277 stars without a colour elsewhere 282 have index 16 (B-V 0.004), while
# its neighbours have 18 and 6.
NO_COLOUR_INDEX = (0, 16)
# Components closer than this are one star to a wide-field camera.
BLEND_ARCSEC = 10.0
ARCSEC = 206264.80625
COMPANION = 3_000_000_000  # + 10 HIP + running number: a component that has no Hipparcos number of its own
# Components have magnitudes Hp. Hp - V by B-V: medians of the single stars among the original lines to V 6.6.
HP_V_COLOUR = [-0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7]
HP_V = [-0.066, -0.027, 0.008, 0.039, 0.063, 0.077, 0.093, 0.110, 0.127, 0.138, 0.149, 0.160, 0.165, 0.167, 0.165, 0.157,
        0.143, 0.124, 0.092, 0.083]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def icosahedron():
    golden = (1 + 5**0.5) / 2
    b = 1 / (1 + golden**2) ** 0.5
    a = b * golden
    corner = np.array([(a, -b, 0), (a, b, 0), (-a, b, 0), (-a, -b, 0), (0, a, -b), (0, a, b), (0, -a, b), (0, -a, -b),
                       (-b, 0, a), (b, 0, a), (b, 0, -a), (-b, 0, -a)])
    faces = [(1, 0, 10), (0, 1, 9), (0, 9, 6), (9, 8, 6), (0, 7, 10), (6, 7, 0), (7, 6, 3), (6, 8, 3), (11, 10, 7),
             (7, 3, 11), (3, 2, 11), (2, 3, 8), (10, 11, 4), (2, 4, 11), (5, 4, 2), (2, 8, 5), (4, 1, 10), (4, 5, 1),
             (5, 9, 1), (8, 9, 5)]
    return corner[np.array(faces)]  # triangle, corner, component


def children(triangles):
    c0, c1, c2 = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    e0, e1, e2 = unit(c1 + c2), unit(c2 + c0), unit(c0 + c1)
    quads = [(c0, e2, e1), (e2, c1, e0), (e1, e0, c2), (e0, e1, e2)]
    return np.stack([np.stack(q, axis=1) for q in quads], axis=1).reshape(-1, 3, 3)


def read_level(path, level, triangles):
    data = path.read_bytes()
    head = struct.unpack_from("<8I", data, 0)
    if head[4] != level:
        raise SystemExit(f"{path}: level {head[4]} where {level} was expected")
    counts = np.frombuffer(data, "<u4", len(triangles), 32)
    layout = np.dtype([("hip", "u1", 3), ("component", "u1"), ("x", "<i4", 2), ("bv", "u1"), ("mag", "u1"), ("sp", "<u2"),
                       ("pm", "<i4", 2), ("plx", "<i4")])
    rows = np.frombuffer(data, layout, int(counts.sum()), 32 + 4 * len(triangles))
    corners = np.repeat(triangles, counts, axis=0)

    z = unit(corners.sum(axis=1))
    x = unit(np.cross([0.0, 0.0, 1.0], z))
    y = np.cross(z, x)
    xi = rows["x"] * (LEVEL_SIDE[level] / SCALE)
    direction = unit(z + xi[:, :1] * x + xi[:, 1:] * y)
    # The stored motion p is neither a rate in RA and Dec nor one in the tangent plane.
    p = rows["pm"] * 0.1
    r2 = 1 + (xi**2).sum(axis=1, keepdims=True)
    motion = (p - xi * (xi * p).sum(axis=1, keepdims=True) / r2) / np.sqrt(r2)
    hip = rows["hip"].astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)
    return dict(hip=hip, direction=direction, motion=motion, parallax=rows["plx"] * 0.01,
                v=FIRST_MAGNITUDE[level] + 0.05 * rows["mag"], bv=-0.5 + 4.0 * rows["bv"] / 127.0)


def read_stellarium(folder):
    triangles = icosahedron()
    levels = []
    for level in range(3):
        levels.append(read_level(folder / f"stars_{level}_0v0_8.cat", level, triangles))
        triangles = children(triangles)
    stars = {key: np.concatenate([part[key] for part in levels]) for key in levels[0]}
    # By Hipparcos number, the brightest component of each first; number 0 is not Hipparcos.
    order = np.lexsort((np.arange(len(stars["hip"])), stars["v"], stars["hip"]))
    order = order[stars["hip"][order] > 0]
    stars = {key: values[order] for key, values in stars.items()}
    first = np.r_[True, stars["hip"][1:] != stars["hip"][:-1]]
    components = {key: values.copy() for key, values in stars.items()}
    return {key: values[first] for key, values in stars.items()}, components


def repair_with_d3(stars, components, path):
    features = json.loads(path.read_text())["features"]
    row = {int(hip): i for i, hip in enumerate(stars["hip"])}
    without_colour = replaced = swapped = matched = 0
    for feature in features:
        i = row.get(int(feature["id"]))
        if i is None:
            continue
        matched += 1
        ra, dec = np.radians(feature["geometry"]["coordinates"])
        place = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        if np.linalg.norm(place - stars["direction"][i]) > CHORD_OF_HALF_ARCSECOND:
            # Of a pair of equals the number may have its place from the other one; proper motion may look like that.
            part = slice(*np.searchsorted(components["hip"], [stars["hip"][i], stars["hip"][i] + 1]))
            others = components["direction"][part]
            nearest = np.argmin(np.linalg.norm(place - others, axis=1))
            equal = components["v"][part][nearest] - components["v"][part][0] < 0.2
            slow = np.linalg.norm(stars["motion"][i]) < 50  # mas/yr
            if equal and slow and np.linalg.norm(place - others[nearest]) < CHORD_OF_HALF_ARCSECOND:
                stars["direction"][i] = others[nearest]
                swapped += 1
            else:
                stars["direction"][i] = place
                replaced += 1
        stars["v"][i] = float(feature["properties"]["mag"])
        colour = feature["properties"]["bv"]
        if colour:
            stars["bv"][i] = float(colour)
        else:
            without_colour += 1
            if round((stars["bv"][i] + 0.5) * 127 / 4) in NO_COLOUR_INDEX:
                stars["bv"][i] = np.nan
    print(f"{len(row)} stars, {matched} with V from d3-celestial, {without_colour} of them without its colour, "
          f"{replaced} places replaced, {swapped} numbers given to the other component")


def blend(stars, components):
    """Puts double stars at their centre of light, and returns the far components as stars of their own.

    V of a number counts its near components already (Hp of the whole number agrees with it in the original lines) and the
    far ones not (Mizar: V 2.23 is that of A)."""
    begins = np.searchsorted(components["hip"], stars["hip"])
    ends = np.searchsorted(components["hip"], stars["hip"], side="right")
    order = np.argsort(stars["direction"][:, 2])
    height = stars["direction"][order, 2]
    blended = 0
    companions = []
    for i in np.flatnonzero(ends - begins > 1):
        part = slice(begins[i], ends[i])
        hp, place = components["v"][part], components["direction"][part]
        # From the component that gives the number its place; the brightest where another source gives it.
        base = np.argmax(np.all(place == stars["direction"][i], axis=1))
        step = place - place[base]
        near = np.linalg.norm(step, axis=1) * ARCSEC < BLEND_ARCSEC
        light = 10 ** (-0.4 * hp[near])
        own_place = stars["direction"][i].copy()
        stars["direction"][i] = unit(own_place + (light[:, None] * step[near]).sum(axis=0) / light.sum())
        blended += bool(near.sum() > 1)
        colour = stars["bv"][i] if np.isfinite(stars["bv"][i]) else 0.65
        for k in np.flatnonzero(~near):
            own = unit(own_place + step[k])
            # Not where another number of the catalogue stands.
            low, high = np.searchsorted(height, [own[2] - 5e-5, own[2] + 5e-5])
            around = order[low:high]
            if np.any(np.linalg.norm(stars["direction"][around] - own, axis=1) * ARCSEC < BLEND_ARCSEC / 2):
                continue
            companions.append(dict(hip=COMPANION + 10 * int(stars["hip"][i]) + int(k), direction=own,
                                   motion=stars["motion"][i], parallax=stars["parallax"][i],
                                   v=hp[k] - float(np.interp(colour, HP_V_COLOUR, HP_V)), bv=np.nan))
    print(f"{blended} double stars at their centre of light; {len(companions)} components are stars of their own")
    return {key: np.concatenate([values, np.array([c[key] for c in companions]).astype(values.dtype)])
            for key, values in stars.items()}


def cells_of(direction, n):
    """Cell of a cube face split into n x n by equal angles; the centre of each cell."""
    axis = np.argmax(np.abs(direction), axis=1)
    rows = np.arange(len(direction))
    major = direction[rows, axis]
    cell = 2 * axis + (major < 0)
    for k in (1, 2):
        t = direction[rows, (axis + k) % 3] / np.abs(major)
        cell = cell * n + np.clip(((np.arctan(t) * 4 / np.pi + 1) / 2 * n).astype(int), 0, n - 1)
    centre = np.zeros((6 * n * n, 3))
    index = np.arange(6 * n * n)
    face, i, j = index // (n * n), index // n % n, index % n
    centre[index, face // 2] = np.where(face % 2, -1.0, 1.0)
    for k, step in ((1, i), (2, j)):
        centre[index, (face // 2 + k) % 3] = np.tan(((step + 0.5) / n * 2 - 1) * np.pi / 4)
    return cell, unit(centre)


def encode(stars, source):
    count = len(stars["hip"])
    n = int(np.clip(round((count / 1800) ** 0.5), 1, 64))
    cell, centre = cells_of(stars["direction"], n)
    v = np.rint(stars["v"] * 1000).astype(np.int64)
    order = np.lexsort((stars["hip"], v, cell))
    record = np.zeros(count, np.dtype([("id", "<u4"), ("d", "<i4", 3), ("pm", "<i4", 2), ("plx", "<i4"), ("v", "<i2"),
                                       ("bv", "<i2")]))
    record["id"] = stars["hip"]
    record["d"] = np.rint(stars["direction"] * SCALE)
    record["pm"] = np.rint(stars["motion"] * 100)
    record["plx"] = np.rint(stars["parallax"] * 100)
    record["v"] = v
    record["bv"] = np.where(np.isnan(stars["bv"]), UNKNOWN_COLOUR, np.rint(np.nan_to_num(stars["bv"]) * 1000))
    record, cell = record[order], cell[order]

    directory = b""
    cells = np.unique(cell)
    for c in cells:
        first, last = np.searchsorted(cell, [c, c + 1])
        d = unit(record["d"][first:last].astype(float))
        cos_radius = float(np.clip((d @ centre[c]).min() - 1e-9, -1, 1))
        directory += struct.pack("<5d2I", *centre[c], cos_radius, (1 - cos_radius**2) ** 0.5, first, last - first)
    body = struct.pack("<2Id32s", count, len(cells), 2000.0, source.encode()) + directory + record.tobytes()
    return struct.pack("<8s2I", b"ANAVSTAR", 1, zlib.crc32(body)) + body


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stellarium", type=pathlib.Path, default="/usr/share/stellarium/stars/default")
    parser.add_argument("--d3", type=pathlib.Path, required=True, help="data/stars.14.json of d3-celestial 0.7.35")
    parser.add_argument("--out", type=pathlib.Path, required=True)
    args = parser.parse_args()

    stars, components = read_stellarium(args.stellarium)
    repair_with_d3(stars, components, args.d3)
    stars = blend(stars, components)
    data = encode(stars, "Hipparcos (ESA 1997)")
    args.out.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    args.out.with_name(args.out.name + ".sha256").write_text(f"{digest}  {args.out.name}\n")
    print(f"{args.out}: {len(data)} bytes, sha256 {digest}")


if __name__ == "__main__":
    main()
