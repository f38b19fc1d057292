# SPDX-License-Identifier: Apache-2.0
"""The protocol of docs/protocol.md, version 1, over a blocking socket."""
import json
import socket
import struct

import numpy as np

_HEADER = struct.Struct("<4sHHII")
_VERSION = 1
_HELLO, _SET, _RENDER, _TRAJECTORY, _CANCEL, _PING = 1, 2, 3, 4, 5, 6
_WELCOME, _SETTINGS, _FRAME, _END, _CANCELLED, _PONG, _ERROR = 101, 102, 103, 104, 105, 106, 199
_PIXELS = {"dn": np.dtype("<u2"), "electrons": np.dtype("<f4")}


class Error(Exception):
    """What the server refused, and why. The session goes on, unless `code` is "io_failure"."""

    def __init__(self, code, message, request=None, index=None):
        super().__init__(f"{code}: {message}")
        self.code = code
        self.message = message
        self.request = request
        self.index = index


class Frame:
    """One picture. `pixels`: rows from the top, uint16 (DN) or float32 (electrons); None of format "png" and "none".
    `png`: the file's bytes of format "png". `info`: everything the server said of it, by the protocol's names, which
    are attributes too: frame.epoch_tdb, frame.q_NC, frame.truth, ..."""

    def __init__(self, info, pixels=None, png=None):
        self.info = info
        self.pixels = pixels
        self.png = png

    def __getattr__(self, name):
        if name == "info" or name not in self.info:
            raise AttributeError(name)
        return self.info[name]

    def __repr__(self):
        return f"Frame({self.info.get('format')}, {self.info.get('width_px')} x {self.info.get('height_px')}, {self.info.get('epoch_tdb')})"


def pointing(ra_deg, dec_deg, roll_deg=0.0):
    """The attitude of a boresight; roll is the position angle of the picture's up direction."""
    return {"ra_deg": float(ra_deg), "dec_deg": float(dec_deg), "roll_deg": float(roll_deg)}


def quaternion(R_NC):
    """The attitude of a rotation matrix that takes camera to ICRF components."""
    R = np.asarray(R_NC, dtype=float)
    # The largest of the four first (Shepperd 1978).
    squares = np.array([np.trace(R), R[0, 0], R[1, 1], R[2, 2]])
    i = int(np.argmax(squares))
    if i == 0:
        q = np.array([1 + squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    elif i == 1:
        q = np.array([R[2, 1] - R[1, 2], 1 + R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]])
    elif i == 2:
        q = np.array([R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], 1 + R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]])
    else:
        q = np.array([R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], 1 + R[2, 2] - R[0, 0] - R[1, 1]])
    q *= (1.0 if q[0] >= 0 else -1.0) / np.linalg.norm(q)
    return {"q_NC": dict(zip("wxyz", map(float, q)))}


def connect(host="127.0.0.1", port=4242, token=None, timeout_s=60.0, name="astronav python"):
    """A session with a server. `with connect() as sky:` closes it."""
    return Client(host, port, token, timeout_s, name)


class Client:
    """One session; for one thread."""

    def __init__(self, host, port, token=None, timeout_s=60.0, name="astronav python"):
        self._next_id = 1
        self._cancels = set()
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except OSError as why:
            raise Error("io_failure", f"no connection to {host} port {port} ({why})") from why
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        hello = {"versions": [_VERSION], "client": name}
        if token is not None:
            hello["token"] = token
        try:
            self.welcome = self._ask(_HELLO, hello, _WELCOME)
        except Error:
            self.close()
            raise

    def close(self):
        self._socket.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def set(self, **scene):
        """Scene fields for the session from now on. Returns all of them."""
        return self._ask(_SET, scene, _SETTINGS)

    def ping(self):
        self._ask(_PING, {}, _PONG)

    def render(self, **scene):
        """One picture."""
        self.send(**scene)
        return self.receive()

    def send(self, **scene):
        """Asks for a picture without waiting; its request's id. Answers come in the order of the requests."""
        return self._send(_RENDER, scene)

    def receive(self):
        """The next picture that was asked for."""
        kind, info, binary = self._receive()
        if kind != _FRAME:
            raise self._out_of_step()
        return self._frame(info, binary)

    def trajectory(self, **request):
        """Pictures of `scenes=[...]`, or of `start=, stop=, step_s=`, one after the other. Who stops early cancels the
        rest."""
        number = self._send(_TRAJECTORY, request)
        ended = False
        failure = None
        try:
            while True:
                try:
                    kind, info, binary = self._receive()
                except Error as error:
                    ended = error.code == "io_failure" or error.index is None
                    if ended:
                        raise
                    failure = error
                    continue
                if kind == _END:
                    ended = True
                    if failure is not None:
                        raise failure
                    return
                yield self._frame(info, binary)
        finally:
            if not ended:
                self._cancels.add(self._send(_CANCEL, {"request": number}))
                while self._receive()[0] != _END:
                    pass

    def _send(self, kind, fields):
        number = 0 if kind == _HELLO else self._next_id
        if kind != _HELLO:
            self._next_id += 1
        text = json.dumps({"id": number, **fields}).encode()
        try:
            self._socket.sendall(_HEADER.pack(b"ANAV", _VERSION, kind, len(text), 0) + text)
        except OSError as why:
            raise Error("io_failure", f"the server cannot be reached any more ({why})") from why
        return number

    def _read(self, view):
        while len(view):
            try:
                n = self._socket.recv_into(view)
            except OSError as why:
                raise Error("io_failure", f"nothing came from the server ({why})") from why
            if n == 0:
                raise Error("io_failure", "the server has closed the connection")
            view = view[n:]

    def _receive(self):
        """The next answer: type, JSON, and the binary part (an array where it is a raw picture, else bytes)."""
        while True:
            head = bytearray(_HEADER.size)
            self._read(memoryview(head))
            magic, version, kind, json_bytes, binary_bytes = _HEADER.unpack(head)
            if magic != b"ANAV" or version != _VERSION:
                raise self._out_of_step()
            text = bytearray(json_bytes)
            self._read(memoryview(text))
            info = json.loads(text)
            binary = np.empty(binary_bytes, np.uint8)
            self._read(memoryview(binary))
            if info.get("id") in self._cancels:
                self._cancels.discard(info["id"])
                continue
            if kind == _ERROR:
                raise Error(info["code"], info["message"], info["id"], info.get("index"))
            return kind, info, binary

    def _ask(self, kind, fields, expected):
        self._send(kind, fields)
        answer, info, _ = self._receive()
        if answer != expected:
            raise self._out_of_step()
        return info

    @staticmethod
    def _frame(info, binary):
        dtype = _PIXELS.get(info["format"])
        if dtype is not None:
            return Frame(info, pixels=binary.view(dtype).reshape(info["height_px"], info["width_px"]))
        return Frame(info, png=binary.tobytes() if info["format"] == "png" else None)

    @staticmethod
    def _out_of_step():
        return Error("io_failure", "another answer than was asked for: receive what is under way first")
