"""A real headless Chromium, driven over its DevTools protocol by a pipe: no driver, no network."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import time

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--mute-audio",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-extensions",
    "--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-pipe", "--js-flags=--expose-gc", "--enable-precise-memory-info",
)  # fmt: skip


class Browser:
    """A browser process; `page` opens a tab. Use as a context manager."""

    def __init__(self, profile, *options, nice=0):
        own_in, self._to = os.pipe()
        self._from, own_out = os.pipe()
        # the browser reads 3 and writes 4; numbers beyond them cannot collide with either
        high = [fcntl.fcntl(end, fcntl.F_DUPFD, 20) for end in (own_in, own_out)]

        def take_pipes():
            os.dup2(high[0], 3)
            os.dup2(high[1], 4)
            os.nice(nice)

        self._process = subprocess.Popen(
            [BROWSER, *OPTIONS, *options, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(3, 4),
            preexec_fn=take_pipes,  # noqa: PLW1509 - dup2 alone is safe
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        for end in (own_in, own_out, *high):
            os.close(end)
        self._rest = b""
        self._number = 0
        self.events = []

    def call(self, method, session=None, timeout_s=30.0, **parameters):
        """Call a DevTools method; return its result. Errors: RuntimeError with the browser's message."""
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        end_s = time.monotonic() + timeout_s
        while True:
            answer = self._message(end_s)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def pump(self, seconds):
        """Take events for a while."""
        with contextlib.suppress(TimeoutError):
            end_s = time.monotonic() + seconds
            while True:
                self._message(end_s)

    def page(self, url="about:blank", width=1280, height=900, **media):
        """Open a tab; ``media``: CSS media features, e.g. prefers_color_scheme='dark'."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        target = self.call("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = Tab(self, session)
        for domain in ("Page", "Runtime", "Log", "Network", "Performance"):
            tab.call(f"{domain}.enable")
        tab.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
            mobile=width < 600,
        )  # fmt: skip
        features = [{"name": name.replace("_", "-"), "value": value} for name, value in media.items()]
        tab.call("Emulation.setEmulatedMedia", features=features)
        if url != "about:blank":
            tab.open(url)
        return tab

    def _message(self, end_s):
        while b"\0" not in self._rest:
            left_s = end_s - time.monotonic()
            if left_s <= 0 or not select.select([self._from], [], [], left_s)[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._from, 1 << 20)
            if not part:
                raise RuntimeError("the browser has ended")
            self._rest += part
        text, _, self._rest = self._rest.partition(b"\0")
        message = json.loads(text)
        if "method" in message:
            self.events.append(message)
        return message

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with contextlib.suppress(RuntimeError, TimeoutError, OSError):
            self.call("Browser.close", timeout_s=5)
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)


class Tab:
    """One page of a browser."""

    def __init__(self, browser, session):
        self.browser, self._session = browser, session

    def call(self, method, **parameters):
        return self.browser.call(method, self._session, **parameters)

    def open(self, url):
        self.call("Page.navigate", url=url)

    def run(self, script):
        """Return the value of a JavaScript expression, of a promise when it is done."""
        done = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in done:
            raise RuntimeError(json.dumps(done["exceptionDetails"])[:2000])
        return done["result"].get("value")

    def text(self, name):
        return self.run(f"document.getElementById({name!r})?.innerText ?? ''")

    def wait(self, condition, timeout_s=15.0):
        """Wait until a JavaScript expression is true; return the seconds it took."""
        begin_s = time.monotonic()
        while not self.run(f"document.readyState === 'complete' && ({condition})"):
            if time.monotonic() - begin_s > timeout_s:
                raise AssertionError(f"not within {timeout_s} s: {condition}; {self.errors()}")
            self.browser.pump(0.05)
        return time.monotonic() - begin_s

    def press(self, key, code, number):
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number)

    def click(self, element):
        """Click on an element, given as a JavaScript expression."""
        box = f"(box => [box.x + box.width / 2, box.y + box.height / 2])(({element}).getBoundingClientRect())"
        x, y = self.run(box)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def heap_bytes(self):
        """Return what the page's objects take, after everything that can be freed has been."""
        self.call("HeapProfiler.collectGarbage")
        return int(self.call("Runtime.getHeapUsage")["usedSize"])

    def metric(self, name):
        return {m["name"]: m["value"] for m in self.call("Performance.getMetrics")["metrics"]}[name]

    def screenshot(self, path):
        import base64

        data = self.call("Page.captureScreenshot", captureBeyondViewport=True)["data"]
        path.write_bytes(base64.b64decode(data))

    def errors(self):
        """Return exceptions, console errors and what the content security policy has blocked."""
        found = []
        for event in self.browser.events:
            if event.get("sessionId") != self._session:
                continue
            what = event["params"]
            if event["method"] == "Runtime.exceptionThrown":
                details = what["exceptionDetails"]
                found.append(details.get("exception", {}).get("description", details["text"]))
            elif event["method"] == "Log.entryAdded" and what["entry"]["level"] == "error":
                found.append(what["entry"]["text"])
        return found

    def requested(self):
        """Return the addresses that the page has asked for."""
        return [
            e["params"]["request"]["url"]
            for e in self.browser.events
            if e["method"] == "Network.requestWillBeSent" and e.get("sessionId") == self._session
        ]
