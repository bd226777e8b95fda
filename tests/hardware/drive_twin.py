"""Drives the twin of a cell from another process, from end to end: no test, takes a minute or two.

    python tests/hardware/drive_twin.py [options of slipmap explore]

A twin comes up in a process of its own, `slipmap explore --hardware` pushes what lies there once and learns
from it, and both end. The exit code is that of exploring. The cell is small: a camera of 320 by 240 pixels at
5 Hz, so that two cores keep up with real time while little else runs, and the guard allows for the hiccups of
a computer that is no controller. The twin says whether it keeps up; where it does not, the guard stops the
arm.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

URL = "udpm://239.255.76.67:7791?ttl=0"
CELL = """\
object: {name: book}
simulation: {time_step: 0.005}
camera: {width: 320, height_pixels: 240, rate: 5.0}
guard: {status_age: 0.4, image_age: 5.0, following: 0.2, lag: 0.5}
"""


def main() -> int:
    slipmap = [sys.executable, "-m", "slipmap"]
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "cell.yaml"
        scenario.write_text(CELL)
        cell = ["--lcm", URL, "--scenario", str(scenario)]
        twin = subprocess.Popen([*slipmap, "station", *cell])
        try:
            time.sleep(5.0)
            once = ["--pushes", "1", "--checks", "0", "--output", f"{folder}/exploration"]
            explore = [*slipmap, "explore", "--hardware", *cell, *once, *sys.argv[1:]]
            return subprocess.run(explore, check=False).returncode
        finally:
            twin.send_signal(signal.SIGINT)
            twin.wait()


if __name__ == "__main__":
    sys.exit(main())
