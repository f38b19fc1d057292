#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The live view in headless Chromium, driven as a person would: the mouse pulls sliders, and the picture changes; it
rests on a star, and its name appears; a button saves the frame. Over Chromium's own debugging pipe, with no library.

    live_view_in_browser.py PROGRAM [PICTURE.jpg]     a picture of the page, where a name is given
"""
import base64
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PATIENCE_S = 90


class Page:
    """One page of a browser, over the pipe of --remote-debugging-pipe: JSON, each message ended by a zero byte."""

    def __init__(self, folder):
        to_read, self.write_end = os.pipe()
        self.read_end, to_write = os.pipe()

        def pipes():  # the browser reads from 3 and writes to 4
            os.dup2(to_read, 60)
            os.dup2(to_write, 61)
            os.dup2(60, 3)
            os.dup2(61, 4)

        self.browser = subprocess.Popen(
            ["chromium", "--no-sandbox", "--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking",
             "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--window-size=1400,1340",
             "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", f"--user-data-dir={folder}/profile",
             "--remote-debugging-pipe", "about:blank"],
            preexec_fn=pipes, close_fds=False, stderr=subprocess.DEVNULL)
        os.close(to_read)
        os.close(to_write)
        self.rest, self.number, self.session, self.events = b"", 0, None, []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t for t in targets if t["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)["sessionId"]
        self.call("Page.enable")
        self.call("Runtime.enable")

    def call(self, method, **parameters):
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.write_end, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self.rest:
                piece = os.read(self.read_end, 1 << 20)
                if not piece:
                    raise RuntimeError("the browser has gone")
                self.rest += piece
            text, self.rest = self.rest.split(b"\0", 1)
            answer = json.loads(text)
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def value(self, expression):
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"])
        return result["result"].get("value")

    def until(self, expression, what):
        end = time.monotonic() + PATIENCE_S
        while not self.value(expression):
            assert time.monotonic() < end, f"waited {PATIENCE_S} s: {what}; status: {self.value('status_text()')}"
            time.sleep(0.1)

    def mouse(self, kind, x, y, **more):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def box(self, name):
        return self.value(f"(() => {{ const b = document.getElementById('{name}').getBoundingClientRect();"
                          " return {x: b.left, y: b.top, w: b.width, h: b.height}; })()")

    def pull(self, name, share):
        """Pulls a slider's thumb to a share of its way."""
        box = self.box(name)
        now = self.value(f"(() => {{ const s = document.getElementById('{name}'); return (s.value - s.min) / (s.max - s.min); }})()")
        y = box["y"] + box["h"] / 2
        at = lambda part: box["x"] + 8 + part * (box["w"] - 16)  # noqa: E731
        self.mouse("mousePressed", at(now), y, button="left", clickCount=1)
        for step in range(1, 6):
            self.mouse("mouseMoved", at(now + (share - now) * step / 5), y, button="left", buttons=1)
        self.mouse("mouseReleased", at(share), y, button="left", clickCount=1)

    def settled(self):
        """Waits until what is drawn is what the sliders say."""
        self.until("!busy && !again && state.drawn > 0", "the picture did not come to rest")

    def sum(self):
        """What is in the picture, as a number."""
        return self.value("(() => { const c = document.getElementById('image'); const d = c.getContext('2d').getImageData(0, 0,"
                          " c.width, c.height).data; let s = 0; for (let i = 0; i < d.length; i += 4) s = (s * 31 + d[i]) >>> 0;"
                          " return s; })()")

    def mean(self, name):
        return self.value(f"(() => {{ const c = document.getElementById('{name}'); const d = c.getContext('2d').getImageData(0, 0,"
                          " c.width, c.height).data; let s = 0; for (let i = 0; i < d.length; i += 4) s += d[i]; return s / d.length * 4; })()")


def check(page, folder, picture):
    page.until("document.documentElement.dataset.drawn > 0", "no first picture")
    page.settled()
    first = page.sum()
    assert page.mean("image") > 1, "the picture is black"
    assert page.mean("sky") > 0.5 and page.mean("craft") > 0.5, "a chart is empty"
    told = page.value("document.getElementById('told').textContent")
    assert "RA 84.000" in told, told

    # Nothing moves by itself: the same scene has the same noise.
    page.value("update()")
    page.settled()
    assert page.sum() == first, "the picture changed though nothing was moved"

    # The mouse on the brightest star: its name, where the truth has it.
    star = page.value("state.truth.sources[0]")
    box = page.box("image")
    scale = box["w"] / 1024
    page.mouse("mouseMoved", box["x"] + (star["u_px"] + 0.5) * scale, box["y"] + (star["v_px"] + 0.5) * scale)
    page.until("!document.getElementById('label').hidden", "no name at the star")
    label = page.value("document.getElementById('label').textContent")
    assert label == f"Rigel (HIP {star['id']}), V {star['mag']:.2f}", (label, star)

    # Each slider changes the picture, and the truth says by how much.
    for name, share, field, expected in [("ra", 0.5, "ra_deg", 180.0), ("dec", 0.25, "dec_deg", -45.0), ("roll", 0.75, "roll_deg", 90.0)]:
        before = page.sum()
        page.pull(name, share)
        page.until(f"Math.abs(state.truth.{field} - {expected}) < 8", f"{name} does not turn the camera")
        page.settled()
        assert page.sum() != before, f"the slider {name} changed nothing"
    before, drawn = page.sum(), page.value("state.drawn")
    page.pull("exposure", 0.9)
    page.until("state.truth.exposure_ms > 10000", "the exposure does not follow")
    page.settled()
    assert page.sum() != before and page.value("state.drawn") > drawn

    # A planet is marked and named: looked at from the Earth.
    place = page.value("(() => { const b = state.sky.bodies.find((b) => b.name.startsWith('jupiter')); return [b.ra_deg, b.dec_deg]; })()")
    page.value(f"document.getElementById('ra').value = {place[0]}; document.getElementById('dec').value = {place[1]};"
               " document.getElementById('exposure').value = 2; document.getElementById('ra').dispatchEvent(new Event('input'))")
    page.until("state.truth.sources.some((s) => s.name && s.name.startsWith('jupiter'))", "no Jupiter")
    page.settled()

    # What the button saves is a PNG of 16 bits.
    page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    box = page.box("save")
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, box["x"] + 5, box["y"] + 5, button="left", clickCount=1)
    saved = folder / "frame.png"
    end = time.monotonic() + PATIENCE_S
    while not (saved.exists() and saved.stat().st_size > 100_000):
        assert time.monotonic() < end, "nothing was saved"
        time.sleep(0.1)
    head = saved.read_bytes()[:26]
    assert head[:8] == b"\x89PNG\r\n\x1a\n" and head[24] == 16, head

    # What is wrong is said, and the page goes on.
    page.value("document.getElementById('observer').value = 'nowhere'; document.getElementById('observer').dispatchEvent(new Event('change'))")
    page.until("document.getElementById('status').className === 'bad'", "a wrong observer is not said")
    page.value("document.getElementById('observer').value = 'mars'; document.getElementById('observer').dispatchEvent(new Event('change'))")
    page.until("document.getElementById('status').className === ''", "the page did not go on")
    page.settled()
    assert page.value("document.documentElement.dataset.errors") == "0", "a script failed"
    if picture:
        page.value("document.getElementById('observer').value = 'earth'; document.getElementById('names').checked = true;"
                   " document.getElementById('ra').value = 84; document.getElementById('dec').value = 0.5;"
                   " document.getElementById('roll').value = 0; document.getElementById('exposure').value = 2.6; update()")
        page.settled()
        time.sleep(0.3)
        Path(picture).write_bytes(base64.b64decode(page.call("Page.captureScreenshot", format="jpeg", quality=80)["data"]))


def main():
    if shutil.which("chromium") is None:
        print("no chromium on this machine")
        sys.exit(1 if os.environ.get("ASTRONAV_REQUIRE_SHARED_DATA") == "1" else 77)
    folder = Path(tempfile.mkdtemp())
    server = subprocess.Popen([sys.argv[1], "serve", "--port", "0", "--web-port", "0", "--json"], stdout=subprocess.PIPE, text=True)
    page = None
    try:
        port = json.loads(server.stdout.readline())["web_port"]
        page = Page(folder)
        page.call("Page.navigate", url=f"http://127.0.0.1:{port}/")
        page.until("document.readyState === 'complete' && location.port !== ''", "the page did not load")
        page.value("globalThis.status_text = () => document.getElementById('status').textContent; 1")
        check(page, folder, sys.argv[2] if len(sys.argv) > 2 else None)
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0, "the server did not end well"
    finally:
        server.kill()
        if page:
            page.browser.kill()
            page.browser.wait()
        shutil.rmtree(folder, ignore_errors=True)
    print("the live view works in the browser")


if __name__ == "__main__":
    main()
