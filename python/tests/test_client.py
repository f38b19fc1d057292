# SPDX-License-Identifier: Apache-2.0
"""The client against a real server: ASTRONAV names the program. `python3 -m unittest discover python/tests`."""
import json
import os
import signal
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np

import astronav

PROGRAM = os.environ["ASTRONAV"]
EPOCH = "2027-03-01T00:00:00 TDB"
CAMERA = Path(os.environ.get("ASTRONAV_HOME") or Path(PROGRAM).resolve().parents[2], "scenarios/cameras/extrema-20deg.toml")


class ClientAgainstServer(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.server = subprocess.Popen([PROGRAM, "serve", "--port", "0", "--json"], stdout=subprocess.PIPE, text=True)
        cls.port = json.loads(cls.server.stdout.readline())["port"]

    @classmethod
    def tearDownClass(cls):
        cls.server.send_signal(signal.SIGTERM)
        assert cls.server.wait(60) == 0
        cls.server.stdout.close()

    def setUp(self):
        self.sky = astronav.connect(port=self.port)
        self.addCleanup(self.sky.close)

    def test_welcome_names_server_and_cameras(self):
        self.assertEqual(self.sky.welcome["version"], 1)
        self.assertTrue(self.sky.welcome["server"].startswith("astronav "))
        self.assertIn("extrema-20deg", self.sky.welcome["cameras"])
        self.sky.ping()

    def test_frame_and_truth_are_those_of_the_render_command(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([PROGRAM, "render", "--epoch", EPOCH, "--observer", "mars", "--pointing", "84,0.5,10", "--seed",
                            "3", "--max-v", "7", "--exposure-ms", "250", "--out", "frame.png", "--truth", "truth.json"],
                           cwd=folder, check=True, stdout=subprocess.DEVNULL)
            png = Path(folder, "frame.png").read_bytes()
            truth = json.loads(Path(folder, "truth.json").read_text())
        scene = dict(epoch=EPOCH, observer="mars", attitude=astronav.pointing(84.0, 0.5, 10.0), seed=3, detector_seed=3,
                     max_v_mag=7, exposure_ms=250)
        frame = self.sky.render(**scene, format="png", truth=True)
        self.assertEqual(frame.png, png)
        del truth["image"]
        self.assertEqual(frame.truth.keys(), truth.keys())
        for ours, theirs in zip(frame.truth["sources"], truth["sources"], strict=True):
            self.assertEqual(ours.keys(), theirs.keys())
            self.assertEqual(ours["id"], theirs["id"])
            self.assertAlmostEqual(ours["u_px"], theirs["u_px"], 9)
            self.assertAlmostEqual(ours["electrons"], theirs["electrons"], 6)
        self.assertIsNone(frame.pixels)

    def test_pixels_are_arrays_with_the_stars_where_the_truth_has_them(self):
        frame = self.sky.render(epoch=EPOCH, attitude=astronav.pointing(84.0, 0.5), truth=True)
        self.assertEqual((frame.pixels.shape, frame.pixels.dtype), ((1024, 1024), np.dtype("<u2")))
        self.assertEqual((frame.width_px, frame.height_px, frame.format), (1024, 1024, "dn"))
        star = frame.truth["sources"][0]
        u, v = round(star["u_px"]), round(star["v_px"])
        self.assertGreater(frame.pixels[v, u], frame.pixels.mean() + 500)
        expected = self.sky.render(epoch=EPOCH, attitude=astronav.pointing(84.0, 0.5), format="electrons")
        self.assertEqual(expected.pixels.dtype, np.dtype("<f4"))
        # Means agree to the noise of a million pixels, gain 25 and bias 64.
        electrons = (frame.pixels.astype(float) - 64.0) * 25.0
        bright = expected.pixels < 2000
        self.assertLess(abs(electrons[bright].mean() - expected.pixels[bright].mean()), 0.2)

    def test_refraction_bodies_and_scenes_that_cost_too_much(self):
        settings = self.sky.set(observer="ground:50,10,100", refraction=True)
        self.assertTrue(settings["refraction"])
        scene = dict(epoch=EPOCH, attitude=astronav.pointing(84.0, 0.5), format="none")
        self.sky.render(**scene)
        for wrong, code in [
            (dict(observer="mars"), "invalid_argument"),
            (dict(bodies=[dict(id=2000433, h=10.4, g=0.46)]), "not_found"),
            (dict(format="dn", max_v_mag=20, rate_deg_s=dict(x=0, y=70, z=0)), "limit_exceeded"),
        ]:
            with self.assertRaises(astronav.Error) as caught:
                self.sky.render(**{**scene, **wrong})
            self.assertEqual(caught.exception.code, code)
        self.assertEqual(self.sky.welcome["limits"]["scene_work"], 2e8)

    def test_matrix_and_pointing_are_the_same_attitude(self):
        rng = np.random.default_rng(4)
        for _ in range(20):
            ra, dec, roll = rng.uniform(0, 360), rng.uniform(-90, 90), rng.uniform(0, 360)
            frame = self.sky.render(epoch=EPOCH, attitude=astronav.pointing(ra, dec, roll), format="none")
            w, x, y, z = (frame.q_NC[k] for k in "wxyz")
            R = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                          [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                          [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
            a, d = np.radians([ra, dec])
            np.testing.assert_allclose(R[:, 2], [np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)], atol=1e-12)
            again = astronav.quaternion(R)["q_NC"]
            np.testing.assert_allclose([again[k] for k in "wxyz"], [w, x, y, z], atol=1e-12)

    def test_session_remembers_and_answers_in_order(self):
        said = self.sky.set(epoch=EPOCH, attitude=astronav.pointing(10, 20), observer="ssb:1.5e8,0,0", max_v_mag=6)
        self.assertEqual((said["observer"], said["max_v_mag"]), ("ssb:1.5e8,0,0", 6.0))
        numbers = [self.sky.send(image=i) for i in range(20)]
        frames = [self.sky.receive() for _ in numbers]
        self.assertEqual([f.id for f in frames], numbers)
        self.assertFalse(np.array_equal(frames[0].pixels, frames[1].pixels))
        np.testing.assert_array_equal(frames[7].pixels, self.sky.render(image=7).pixels)

    def test_trajectory_and_its_early_end(self):
        fields = dict(start=EPOCH, step_s=86400, attitude={"body": "jupiter"}, truth=True)
        frames = list(self.sky.trajectory(stop="2027-03-05T00:00:00 TDB", **fields))
        self.assertEqual([f.index for f in frames], [0, 1, 2, 3, 4])
        for frame in frames:
            jupiter = next(s for s in frame.truth["sources"] if s.get("name", "").startswith("jupiter"))
            self.assertLess(abs(jupiter["u_px"] - 511.5), 0.2)
        for frame in self.sky.trajectory(stop="2047-03-05T00:00:00 TDB", **fields):
            if frame.index == 3:
                break
        self.sky.ping()
        with self.assertRaises(astronav.Error) as refused:
            list(self.sky.trajectory(start="2049-12-01", stop="2060-01-01", step_s=1e7, attitude={"body": "mars"}))
        self.assertEqual(refused.exception.code, "out_of_range")
        self.assertGreater(refused.exception.index, 0)
        self.sky.ping()

    def test_what_is_refused_is_an_error_and_the_session_goes_on(self):
        for fields, code in [({"camera": "none"}, "not_found"), ({"exposure": 3}, "invalid_argument"),
                             ({"epoch": "2400-01-01"}, "out_of_range"), ({"observer": "oem:/etc/passwd"}, "unsupported")]:
            with self.assertRaises(astronav.Error) as refused:
                self.sky.render(**{"epoch": EPOCH, "attitude": astronav.pointing(1, 2), **fields})
            self.assertEqual(refused.exception.code, code, fields)
        self.sky.ping()
        with self.assertRaises(astronav.Error) as refused:
            astronav.connect(port=1)
        self.assertEqual(refused.exception.code, "io_failure")


class ServerOfItsOwn(unittest.TestCase):
    """What the command line gives a server: a token, a trajectory, a camera."""

    def serve(self, *arguments, **more):
        server = subprocess.Popen([PROGRAM, "serve", "--port", "0", "--json", *arguments], stdout=subprocess.PIPE, text=True, **more)

        def stop():
            server.send_signal(signal.SIGINT)
            self.assertEqual(server.wait(60), 0)
            server.stdout.close()

        self.addCleanup(stop)
        return json.loads(server.stdout.readline())["port"]

    def test_other_machines_need_the_token(self):
        port = self.serve("--listen", "0.0.0.0", env={**os.environ, "ASTRONAV_TOKEN": "a b c"})
        astronav.connect(port=port, token="a b c").close()
        for wrong in (None, "", "a b", "a b c "):
            with self.assertRaises(astronav.Error) as refused:
                astronav.connect(port=port, token=wrong)
            self.assertEqual(refused.exception.code, "invalid_argument")

    def test_named_trajectory_and_camera(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        states = "\n".join(f"2027-03-{day:02}T00:00:00 {1e8 + 2e6 * day} {5e7} {-1e6 * day} {2e6 / 86400} 0 {-1e6 / 86400}"
                           for day in range(1, 11))
        Path(folder.name, "craft.oem").write_text(
            "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2026-11-22T00:00:00\nORIGINATOR = TEST\nMETA_START\nOBJECT_NAME = CRAFT\n"
            "OBJECT_ID = 2026-001A\nCENTER_NAME = SOLAR SYSTEM BARYCENTER\nREF_FRAME = ICRF\nTIME_SYSTEM = TDB\n"
            "START_TIME = 2027-03-01T00:00:00\nSTOP_TIME = 2027-03-10T00:00:00\nMETA_STOP\n" + states + "\n")
        Path(folder.name, "own.toml").write_text(CAMERA.read_text().replace("width_px = 1024", "width_px = 640"))
        port = self.serve("--observer", "craft=oem:craft.oem", "--camera", "own.toml", "--workers", "1", cwd=folder.name)
        with astronav.connect(port=port) as sky:
            self.assertEqual(sky.welcome["observers"], ["craft"])
            self.assertIn("own", sky.welcome["cameras"])
            frame = sky.render(epoch="2027-03-05T12:00:00 TDB", observer="craft", camera="own", attitude={"body": "sun"}, truth=True)
            self.assertEqual(frame.pixels.shape, (1024, 640))
            place = frame.truth["observer"]["position_km"]
            np.testing.assert_allclose([place[k] for k in "xyz"], [1.11e8, 5e7, -5.5e6], atol=1.0)
            with self.assertRaises(astronav.Error) as refused:
                sky.render(epoch="2027-04-05", observer="craft", attitude={"body": "sun"})
            self.assertEqual(refused.exception.code, "out_of_range")


if __name__ == "__main__":
    unittest.main()
