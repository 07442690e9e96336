"""What logged poses say of a robot's geometry, as a table of text."""

from __future__ import annotations

import textwrap

from gtau.estimation.diagnostics.geometry_findings import GeometryTest, percent
from gtau.estimation.thresholds.logs import POSE_DELAY_STD

WIDTH = 80
NAME = 36
LISTED = 5
ROUNDING = 1e-3  # of the rms: a smaller bias is written as zero


def geometry_lines(test: GeometryTest) -> list[str]:
    """Tabulate pose residuals and changes of the constants as text, 80 columns wide."""
    head = f"Pose of '{test.body}' ({test.source})"
    lines = [f"{head:<50}{'rms':>11}{'bias':>11}   unit"]
    for each in test.residuals:
        unit = f"m{each.unit}"
        bias = 1e3 * each.bias if abs(each.bias) > ROUNDING * each.rms else 0.0
        lines.append(f"  {f'{each.run}  {each.name}':<48}{1e3 * each.rms:>11.3g}{bias:>11.2g}   {unit}")
    lines += [] if test.delay_std > POSE_DELAY_STD else [f"  {late(test)}"]
    lines.append(f"{'Constant, by itself':<36}{'in file':>9}{'change':>10}{'std':>10}{'explains':>10} unit")
    for constant in test.tried[:LISTED]:
        name = f"  {constant.name:<34}"
        if len(name) > NAME:  # on a line of its own
            lines.append(name)
            name = ""
        numbers = f"{1e3 * constant.value:>9.5g}{1e3 * constant.change:>10.3g}{1e3 * constant.std:>10.2g}"
        lines.append(f"{name:<{NAME}}{numbers}{percent(constant.share, 2):>10} m{constant.unit}")
    if len(test.tried) > LISTED:
        lines.append(f"  and {len(test.tried) - LISTED} more, which explain less: --json")
    if test.unseen:
        lines += textwrap.wrap(
            f"not identifiable by this pose: {', '.join(test.unseen)}",
            WIDTH,
            initial_indent="  ",
            subsequent_indent="  ",
        )
    return lines


def late(test: GeometryTest) -> str:
    """Say by how much the poses lag behind the positions."""
    return f"the poses lag {1e3 * test.delay:.1f} +- {1e3 * test.delay_std:.1g} ms behind the positions"
