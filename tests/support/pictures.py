"""Draws dashboards with the real viewer and counts the pixels of every curve.

    python pictures.py VIEWER RECORDING FOLDER NAME [CROP...] < jobs.json > counts.json

Jobs: [{"name": ..., "file": x.rbl, "plots": [{"id": ..., "mark": [r, g, b], "share": 0..1, "colors": [[r, g, b], ...]}]}].
One viewer loads the recording once and draws what it brings along to FOLDER/NAME.png; every dashboard is sent to it and drawn to FOLDER/NAME.png. A plot is where its
mark is the background; its left share (the rest belongs to the legend) is searched for the colours of its curves.
"""

import io
import json
import os
import socket
import subprocess
import sys
import tempfile
import time

import numpy as np
from PIL import Image
from rerun.experimental import ViewerClient

PATIENCE_S = 120.0


def wait_for(what, done):
    end = time.monotonic() + PATIENCE_S
    while True:
        result = done()
        if result is not None:
            return result
        if time.monotonic() > end:
            sys.exit(f"no {what} after {PATIENCE_S} s")
        time.sleep(0.02)


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def connect(url):
    try:
        return ViewerClient.connect(url)
    except Exception:  # whatever it is, it is not listening yet
        return None


def png(path):
    """The picture, once it is there to its end: the viewer writes it later."""
    try:
        with open(path, "rb") as file:
            data = file.read()
    except FileNotFoundError:
        return None
    return data if data[-8:-4] == b"IEND" else None


def shoot(client, path):
    if os.path.exists(path):
        os.remove(path)
    client.save_screenshot(path)
    return wait_for(f"picture {path}", lambda: png(path))


def settled(client, path, good):
    """A picture that no longer changes and is good: recording and dashboard are loaded."""
    before = []

    def same():
        now = shoot(client, path)
        before.append(now)
        if before[-2:].count(now) < 2:
            return None
        return good(Image.open(io.BytesIO(now)).convert("RGB"))

    return wait_for(f"still picture {path}", same)


def boxes(image, plots):
    """Where the plots are; nothing when one of them is not there."""
    pixels = np.asarray(image)
    found = {}
    for plot in plots:
        marked = (pixels == plot["mark"]).all(axis=2)
        # A stray pixel of this colour is no plot.
        rows, columns = np.flatnonzero(marked.sum(axis=1) > 9), np.flatnonzero(marked.sum(axis=0) > 9)
        if not len(rows) or not len(columns):
            return None
        # A flat curve at the edge of its plot hides the mark there.
        rows, columns = [slice(max(0, at[0] - 3), at[-1] + 4) for at in (rows, columns)]
        found[plot["id"]] = pixels[rows, columns].astype(float)
    return found


def count(pixels, mark, color):
    """Pixels that are the colour, or a mixture of it and the background: curves have soft edges."""
    offset, to_color = pixels - np.array(mark), np.array(color, dtype=float) - mark
    part = offset @ to_color / (to_color @ to_color)
    rest = np.abs(offset - part[..., None] * to_color).sum(axis=2)
    return int(((part > 0.4) & (part < 1.1) & (rest < 40)).sum())


def main():
    viewer, recording, folder = sys.argv[1:4]
    jobs = json.load(sys.stdin)
    port = free_port()
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    home = tempfile.mkdtemp()
    env = dict(os.environ, RUST_LOG="error", HOME=home, XDG_RUNTIME_DIR=home)
    # Most of the time goes into the pixels: those of pictures that are kept are more.
    size = "1600x900" if sys.argv[5:] else "1280x720"
    arguments = [viewer, "--headless", "--port", str(port), "--window-size", size, recording]
    counts = {}
    running = subprocess.Popen(arguments, env=env, stdout=sys.stderr)
    try:
        client = wait_for("viewer", lambda: connect(url))
        # A dashboard that comes before the recording would give way to those in the recording.
        brought = settled(client, os.path.join(folder, sys.argv[4] + ".png"), lambda image: image)
        for job in jobs:
            subprocess.run([viewer, "--port", str(port), job["file"]], env=env, check=True, stdout=sys.stderr)
            plots = job["plots"]
            path = os.path.join(folder, job["name"] + ".png")
            found = settled(client, path, lambda image, plots=plots: None if image == brought else boxes(image, plots))
            of_job = {}
            for plot in plots:
                pixels = found[plot["id"]]
                curves = pixels[:, : int(pixels.shape[1] * plot["share"])]
                of_job[plot["id"]] = [count(curves, plot["mark"], color) for color in plot["colors"]]
            counts[job["name"]] = of_job
    finally:
        running.kill()
        running.wait()
    # Without the viewer's own bar, which says on what machine it runs.
    for name in sys.argv[5:]:
        path = os.path.join(folder, name + ".png")
        image = Image.open(path).convert("RGB")
        image.crop((0, 28, image.width, image.height)).save(path, optimize=True)
    json.dump(counts, sys.stdout)


main()
