# SPDX-License-Identifier: Apache-2.0
"""Client of the SkySimulator server (`astronav serve`): pictures of the sky as NumPy arrays.

    with astronav.connect(port=4242) as sky:
        frame = sky.render(epoch="2027-03-01", attitude=astronav.pointing(84.0, 0.5))
        frame.pixels        # (1024, 1024), uint16
"""
from .client import Client, Error, Frame, connect, pointing, quaternion

__all__ = ["Client", "Error", "Frame", "connect", "pointing", "quaternion"]
