"""Show tracking errors of control laws (the paper's Table 4), as a page."""

from __future__ import annotations

from gtau.report.page import Column, Kind, Page, page, section, table
from gtau.simulation.control_comparison import ControlComparison

MICRO = 1e6


def control_page(comparison: ControlComparison) -> Page:
    """Show the largest and the rms tracking errors of each law, in micrometres or microradians."""
    named = list(zip(comparison.joints, comparison.units, strict=True))
    columns = [Column("strategy")]
    columns += [Column(f"largest {joint}, µ{unit}", Kind.NUMBER, decimals=0) for joint, unit in named]
    columns += [Column(f"rms {joint}, µ{unit}", Kind.NUMBER, decimals=0) for joint, unit in named]
    sections = [
        section(
            f"Tracking errors on {trajectory}",
            table(
                columns,
                [
                    (each.strategy, *(MICRO * each.maximum).tolist(), *(MICRO * each.rms).tolist())
                    for each in comparison.tracking
                    if each.trajectory == trajectory
                ],
            ),
        )
        for trajectory in comparison.references
    ]
    return page("", *sections)
