#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A small attitude controller before the SkySimulator: twice a second it takes a picture, finds the brightest star in it
and commands rates that bring the star to the centre and hold it there, though the spacecraft drifts.

    astronav serve --port 4242 &
    point_at_star.py --port 4242
"""
import argparse
import csv
import sys

import numpy as np

import astronav

PERIOD_S = 0.5
EXPOSURE_MS = 50
GAIN = 0.8          # per second, of the angle
INTEGRAL_GAIN = 0.2  # per second squared: learns the drift
MAX_RATE_DEG_S = 1.0
DRIFT_DEG_S = np.array([0.04, -0.03, 0.02])  # what the controller does not know
HELD_PX, HELD_FRAMES, MAX_FRAMES = 0.2, 10, 120


def rotation(vector):
    """The matrix of a rotation vector."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def brightest_star(pixels):
    """Centroid (u, v) of the brightest spot: the patch of 3 x 3 pixels with the most light tells where, 9 x 9 where
    exactly."""
    light = pixels.astype(float) - np.median(pixels)
    sums = sum(np.roll(light, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1))
    v, u = np.unravel_index(np.argmax(sums[5:-5, 5:-5]), sums[5:-5, 5:-5].shape)
    u, v = u + 5, v + 5
    patch = np.clip(light[v - 4 : v + 5, u - 4 : u + 5], 0.0, None)
    dv, du = np.mgrid[-4:5, -4:5]
    return u + (patch * du).sum() / patch.sum(), v + (patch * dv).sum() / patch.sum()


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--port", type=int, default=4242)
    port = arguments.parse_args().port
    with astronav.connect(port=port) as sky, open("loop.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "off_u_px", "off_v_px", "rate_x_deg_s", "rate_y_deg_s"])
        sky.set(observer="earth", camera="extrema-20deg", exposure_ms=EXPOSURE_MS, epoch="2027-03-01T00:00:00 TDB")
        # Sirius, 6 degrees off.
        first = sky.render(attitude=astronav.pointing(97.0, -12.0, 15.0), format="none")
        w, x, y, z = (first.q_NC[k] for k in "wxyz")
        R_NC = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
        centre = np.array([(first.width_px - 1) / 2, (first.height_px - 1) / 2])
        focal_px = first.width_px / 2 / np.tan(np.radians(10.0))
        command = np.zeros(3)
        learnt = np.zeros(2)
        held = 0
        for image in range(MAX_FRAMES):
            rate = command + DRIFT_DEG_S
            # The camera turns while it looks: the picture is smeared.
            frame = sky.render(attitude=astronav.quaternion(R_NC), image=image,
                               rate_deg_s=dict(zip("xyz", map(float, rate))))
            off = np.array(brightest_star(frame.pixels)) - centre
            table.writerow([f"{image * PERIOD_S:.1f}", *(f"{o:.3f}" for o in off), *(f"{c:.4f}" for c in command[:2])])
            held = held + 1 if np.linalg.norm(off) < HELD_PX else 0
            if held == HELD_FRAMES:
                print(f"the star is held within {HELD_PX} px; it took {(image - HELD_FRAMES + 1) * PERIOD_S:.1f} s")
                print(f"drift found: {-learnt[0]:.3f}, {-learnt[1]:.3f} deg/s; true: {DRIFT_DEG_S[0]}, {DRIFT_DEG_S[1]}")
                return 0
            # A turn about +y moves stars to -u, one about +x moves them to +v.
            angle = np.degrees(np.array([-off[1], off[0]]) / focal_px)
            wanted = GAIN * angle + learnt
            command[:2] = np.clip(wanted, -MAX_RATE_DEG_S, MAX_RATE_DEG_S)
            if np.all(np.abs(wanted) < MAX_RATE_DEG_S):  # else the sum would run away
                learnt += INTEGRAL_GAIN * angle * PERIOD_S
            R_NC = R_NC @ rotation(np.radians(command + DRIFT_DEG_S) * PERIOD_S)
    print(f"the star was not held within {HELD_PX} px after {MAX_FRAMES} frames", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
