#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Many clients at once before one server, good ones and bad ones, for a while.

Each good client keeps four requests under way and checks every answer: its id, its size, and that pictures of the same
name have the same pixels, whoever asked. Meanwhile others connect and say nothing, send half a message, lie about
lengths, vanish with a trajectory under way, or do not read. At the end the server has to stop with exit status 0 and to
hold no more memory than at half-time. One JSON line tells what happened; exit status 1 where anything was wrong."""
import argparse
import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib
from multiprocessing import Process, Queue
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))
import astronav  # noqa: E402

IMAGES = 16
SCENE = dict(epoch="2027-03-01T00:00:00 TDB", observer="earth", camera="extrema-20deg", max_v_mag=8)


def message(kind, text, json_bytes=None):
    return b"ANAV" + struct.pack("<HHII", 1, kind, len(text) if json_bytes is None else json_bytes, 0) + text


def good_client(number, port, seconds, results):
    frames, latencies, sums, wrong = 0, [], {}, []
    try:
        with astronav.connect(port=port, name=f"client {number}") as sky:
            sky.set(**SCENE)
            begin = time.monotonic()
            under_way = []
            image = number
            while True:
                running = time.monotonic() - begin < seconds
                while running and len(under_way) < 4:
                    name = image % IMAGES
                    image += 1
                    attitude = astronav.pointing(22.5 * name, -40 + 5 * name)
                    under_way.append((sky.send(attitude=attitude, image=name), name, time.monotonic()))
                if not under_way:
                    break
                frame = sky.receive()
                request, name, asked = under_way.pop(0)
                latencies.append(time.monotonic() - asked)
                frames += 1
                if frame.id != request:
                    wrong.append(f"answer {frame.id} to request {request}")
                if frame.pixels.shape != (1024, 1024):
                    wrong.append(f"a picture of {frame.pixels.shape}")
                if frames % 8 == 1:  # the sum costs more than the picture
                    value = zlib.crc32(frame.pixels)
                    if sums.setdefault(name, value) != value:
                        wrong.append(f"picture {name} changed")
    except astronav.Error as error:
        wrong.append(str(error))
    results.put((frames, latencies[:: max(1, len(latencies) // 2000)], sums, wrong[:5]))


def bad_client(port, seconds):
    hello = message(1, b'{"id":0,"versions":[1]}')
    endless = message(4, json.dumps(dict(id=1, start="2027-03-01", stop="2027-03-02", step_s=1,
                                         attitude=dict(ra_deg=1, dec_deg=2))).encode())
    kept = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            connection = socket.create_connection(("127.0.0.1", port), 5)
            kind = random.randrange(6)
            if kind == 0:
                pass  # silent
            elif kind == 1:
                connection.sendall(hello + message(3, b'{"id":1', 500_000))  # promises more
            elif kind == 2:
                connection.sendall(hello + message(3, b"", 0xFFFFFFFF))
            elif kind == 3:
                connection.sendall(random.randbytes(300))
            else:
                connection.sendall(hello + endless)  # does not read; or is gone
            kept.append(connection)
            if len(kept) > 4 or kind == 5:
                kept.pop(random.randrange(len(kept))).close()
        except OSError:
            pass
        time.sleep(0.05)


def resident_mb(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("program")
    arguments.add_argument("--seconds", type=float, default=60)
    arguments.add_argument("--clients", type=int, default=10)
    options = arguments.parse_args()
    server = subprocess.Popen([options.program, "serve", "--port", "0", "--json", "--sessions", str(options.clients + 8)],
                              stdout=subprocess.PIPE, text=True)
    try:
        port = json.loads(server.stdout.readline())["port"]
        results = Queue()
        clients = [Process(target=good_client, args=(n, port, options.seconds, results)) for n in range(options.clients)]
        clients.append(Process(target=bad_client, args=(port, options.seconds)))
        begin = time.monotonic()
        for client in clients:
            client.start()
        time.sleep(options.seconds / 2)
        half_mb = resident_mb(server.pid)
        collected = [results.get(timeout=options.seconds + 60) for _ in range(options.clients)]
        took = time.monotonic() - begin
        for client in clients:
            client.join(60)
        end_mb = resident_mb(server.pid)
        server.send_signal(signal.SIGTERM)
        status = server.wait(30)
    finally:
        server.kill()

    wrong = [sentence for each in collected for sentence in each[3]]
    sums = {}
    for _, _, theirs, _ in collected:
        for name, value in theirs.items():
            if sums.setdefault(name, value) != value:
                wrong.append(f"picture {name} is not the same for all")
    counts = [each[0] for each in collected]
    if min(counts) == 0:
        wrong.append("a client got nothing")
    if status != 0:
        wrong.append(f"the server ended with status {status}")
    if end_mb > half_mb + 200:
        wrong.append(f"the server grew from {half_mb:.0f} to {end_mb:.0f} MB")
    latencies = sorted(value for each in collected for value in each[1])
    print(json.dumps(dict(clients=options.clients, seconds=round(took, 1), frames=sum(counts),
                          frames_per_s=round(sum(counts) / took, 1), fewest=min(counts), most=max(counts),
                          latency_ms=dict(median=round(1e3 * latencies[len(latencies) // 2], 2),
                                          p99=round(1e3 * latencies[int(0.99 * (len(latencies) - 1))], 2)),
                          server_mb=dict(half_time=round(half_mb), end=round(end_mb)), wrong=wrong)))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
