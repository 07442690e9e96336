"""
A bad log and its report
========================

The driver has logged the current of one motor 40 ms late. A fit alone would still give numbers; gtau reports that they
contradict the data, names the joint and the cause, and states what to do.
"""

from pathlib import Path
from tempfile import mkdtemp

import polars as pl

import gtau
from gtau.demo import write_tutorial

# %%
# Shift one column by ten samples of 4 ms.
folder = Path(mkdtemp())
write_tutorial(folder)
signals = {
    "time": "t",
    "position": {"left": "qleft", "right": "qright"},
    "current": {"left": "vleft", "right": "vright"},
}


def late(log: str) -> pl.DataFrame:
    """Return the log with the current of 'left' 40 ms late."""
    return pl.read_csv(folder / log).with_columns(pl.col("vleft").shift(10, fill_value=0.0))


runs = [
    gtau.read_run(late("empty_1.csv"), signals),
    gtau.read_run(late("loaded_1200g.csv"), signals, payload={"name": "steel", "mass": 1.2}),
]
result = gtau.identify(gtau.load_robot("five-bar"), runs)
print(result.summary(verbose=False))

# %%
# Programs ask the verdicts.
for joint, gain in result.drive_gains.items():
    print(joint, gain.verdict.outcome, gain.verdict.finding.kind if gain.verdict.finding else "", sep=", ")

# %%
# Measured and predicted torque of the joint. ``result.report(path)`` writes the whole report as one HTML file.
figure = result.plot.torques("left", stop=3.0)
