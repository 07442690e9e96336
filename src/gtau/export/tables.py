"""Gains, delays, friction, base parameters and payloads with their intervals, as YAML and as one table in CSV."""

from __future__ import annotations

import textwrap
from pathlib import Path

import yaml

from gtau.documents.files import in_csv
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.identified_model import estimates_table
from gtau.estimation.results.result import Result
from gtau.export.exported import Exported, identifier, written

HEAD = """\
# Identified model of '{robot}', written by 'gtau export'. SI units; std: standard deviation; interval: 95 %.
# Torque of a joint = drive gain x current. Base parameters ending in R stand for the sum under 'regrouping'.
{friction}
"""


def export_csv(result: Result, out: Path) -> Exported:
    """Write ``NAME.csv`` into ``out``: one row per estimate, with value, std, 95 % interval and unit."""
    return Exported(written(out, {f"{identifier(result.robot.name)}.csv": in_csv(result.to_frame())}))


def export_yaml(result: Result, out: Path) -> Exported:
    """Write ``NAME.yaml`` into ``out``."""
    groups: dict[str, dict[str, object]] = {}
    for row in estimates_table(result):
        groups.setdefault(_key(row.group), {})[row.estimate.name] = _entry(row.estimate)
    document = {"robot": result.robot.name, "method": result.method, "runs": list(result.runs), **groups}
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    head = HEAD.format(robot=" ".join(result.robot.name.split()), friction=_comment(result.friction_law.range_sentence))
    return Exported(written(out, {f"{identifier(result.robot.name)}.yaml": head + text}))


def _comment(text: str) -> str:
    return textwrap.fill(" ".join(text.split()), 116, initial_indent="# ", subsequent_indent="# ")


def _key(group: str) -> str:
    return group if group in ("friction",) or group.startswith("payload") else f"{group.replace(' ', '_')}s"


def _entry(each: Estimate) -> dict[str, object]:
    entry: dict[str, object] = {"value": each.value, "std": each.std, "unit": each.unit}
    if (interval := each.interval()) is not None:
        entry["interval"] = list(interval)
    if each.verdict.outcome.value not in ("good", "given"):
        entry["verdict"] = each.verdict.outcome.value
    if each.regrouping not in ("", each.name):
        entry["regrouping"] = each.regrouping
    return entry
