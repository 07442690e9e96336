"""Scale of the gains by the inertias of robots' files, beside that of payloads or of torques that are reported as true.

    python benchmarks/file_scale.py [--panda panda.urdf]

The logs lie beside the checkout (``../shared/data``). Runs with payloads are left out and torques taken for currents,
so that the file alone gives the scale. The Panda's file is that of the package ``example-robot-data``, fingers fixed.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from effort import airbot
from zoo import aliengo, kuka, panda, panda_rosbag2, ur10e, xmate7p

from gtau.errors import GtauError
from gtau.result import identify

DATA = Path(__file__).parents[2] / "shared" / "data"
STD = 0.3


def with_file(write: Callable[[Path, Path], str], robot: Path, names: dict[str, str]) -> Callable[[Path, Path], str]:
    """Replace the robot of an experiment file by one that states inertias, with its names of the joints."""

    def written(data: Path, folder: Path) -> str:
        text = re.sub(r"robot: '[^']*'", f"robot: '{robot}'", write(data, folder))
        for old, new in names.items():
            text = text.replace(f"{old}:", f"{new}:")
        return re.sub(r", to: [\d.]+", "", text)

    return written


def unloaded(text: str) -> str:
    """Leave out the runs with payloads, and take torques for currents."""
    lines = [line for line in text.split("validation:")[0].splitlines() if "payload" not in line]
    return "\n".join(lines).replace("  torque:", "  current:") + "\n"


def main() -> None:
    """Print a row a robot."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--panda", type=Path)
    asked = parser.parse_args()
    logs = {"ur10e": with_file(ur10e, DATA / "ur10e" / "ur10e.urdf", {}), "xmate7p": xmate7p("", 50)}
    logs |= {"xmate7p, 1 kHz": xmate7p("50Hz_5periods", 1000), "kuka": kuka, "airbot": airbot, "aliengo": aliengo}
    if asked.panda:
        names = {f"j{k}": f"panda_joint{k}" for k in range(1, 8)}
        pairs = ("panda", panda), ("panda, ROS", panda_rosbag2)
        logs |= {name: with_file(write, asked.panda, names) for name, write in pairs}
    for name, write in logs.items():
        print(f"| {name} | {row(write)} |", flush=True)


def row(write: Callable[[Path, Path], str]) -> str:
    """Identify the unloaded runs by the file's scale, and all runs by their own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.yaml"
        text = write(DATA, Path(folder))
        path.write_text(text, encoding="utf-8")
        known = identify(path).drive_gains if "payload" in text else {}
        path.write_text(unloaded(text), encoding="utf-8")
        try:
            gains = identify(path, prior_inertias=STD).drive_gains
        except GtauError as refusal:
            return str(refusal)
    narrow = {joint: gain.value for joint, gain in gains.items() if gain.half_width and gain.half_width < 100}
    ratios = [value / (known[joint].value if known else 1.0) for joint, value in narrow.items()]
    return f"{len(ratios)} of {len(gains)} | {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


if __name__ == "__main__":
    main()
