"""Play a round's motion on a Universal Robot by servoJ of ur_rtde, and log its receive stream.

    python play_ur.py camp/01 --host 192.168.1.10 [--speed 0.1]

Enter in the terminal stops the motion, as does a tracking error or a protective stop. A speed slider below 100 %
stretches the motion: the log holds what was played, and gtau uses it as such.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from contract import APPROACH, Motion, mount, play_round, pressed, read_motion, write_log

LOOKAHEAD, STIFFNESS = 0.05, 300.0  # s, and gain of servoJ


def play_run(motion: Motion, control: Any, receive: Any, stopped: Any = pressed) -> tuple[np.ndarray, ...]:
    """Play one run; return time, positions and currents as logged, and how it ended."""
    motion.refuse_start(np.array(receive.getActualQ()))
    control.moveJ(motion.q[0].tolist(), float(np.abs(motion.q[0] - receive.getActualQ()).max() / APPROACH + 0.01))
    step, rows, end, now = 1.0 / motion.file["rate"], [], "completed", 0.0
    try:
        while end == "completed" and now <= motion.time[-1]:
            begun = control.initPeriod()
            control.servoJ(motion.at(now)[0].tolist(), 0.0, 0.0, step, LOOKAHEAD, STIFFNESS)
            here = np.array(receive.getActualQ())
            rows.append((receive.getTimestamp(), here, np.array(receive.getActualCurrent())))
            if receive.isProtectiveStopped():
                end = "protective stop"
            elif stopped():
                end = "stopped by the operator"
            else:  # servoJ follows late by its lookahead
                end = motion.strayed(here, motion.at(max(now - LOOKAHEAD, 0.0))[0]) or "completed"
            now += step * receive.getSpeedScaling()
            control.waitPeriod(begun)
    finally:
        control.servoStop()
    time_, q, current = (np.array(column) for column in zip(*rows, strict=True))
    return time_ - time_[0], q, current, end


def main() -> None:
    """Play all runs of a round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("round", type=Path)
    parser.add_argument("--host", required=True)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    rate = read_motion(options.round).file["rate"]
    control, receive = RTDEControlInterface(options.host, rate), RTDEReceiveInterface(options.host)

    def one_run(run: dict, motion: Motion) -> tuple[str, str]:
        mount(run)
        *log, end = play_run(motion, control, receive)
        return write_log(motion, run["name"], *log), end

    play_round(options.round, options.speed, one_run)


if __name__ == "__main__":
    main()
