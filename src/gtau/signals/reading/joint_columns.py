"""Columns of a log matched with the joints of a robot: by name, by nearly the same name, by number or by order."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from gtau.errors import GtauError
from gtau.findings.words import counted
from gtau.robots.robot import Robot
from gtau.signals.reading.column_names import Group, resembling


def matched(
    positions: Group, commands: Group, robot: Robot | None
) -> tuple[dict[str, str], dict[str, str], dict[str, str], str, bool]:
    """Match columns with joints, also where the joints' names in them are misspelt.

    Returns, by joint, columns of positions and of commands and the label in their names; how they were matched; and
    whether by these names.
    """
    names = dict[str, str]()
    labels = {name: label for label, name in positions.columns.items()}
    if robot:
        (positions, names), (commands, more) = (
            renamed_labels(group, robot.actuated) for group in (positions, commands)
        )
        names |= more
    pairs, how, by_order = _pairs(positions, commands, robot)
    how += "".join(f", {label} taken for {joint}" for label, joint in names.items())
    columns, currents = ({joint: pair[k] for joint, pair in pairs.items()} for k in (0, 1))
    logged = {joint: labels[column] for joint, column in columns.items()}
    return columns, currents, logged, how, not by_order and not names


def _pairs(positions: Group, commands: Group, robot: Robot | None) -> tuple[dict[str, tuple[str, str]], str, bool]:
    """Pair columns of positions and commands by joint, of a robot without loops for some of them.

    Also return how they were matched, and whether by their order alone.
    """
    common = [label for label in positions.columns if label in commands.columns]
    pairs = {label: (positions.columns[label], commands.columns[label]) for label in common}
    by_order = False
    if not common and len(positions.columns) == len(commands.columns):
        columns = zip(_ordered(positions.columns), _ordered(commands.columns), strict=True)
        pairs = {q: (positions.columns[q], commands.columns[v]) for q, v in columns}
        by_order = True
    if robot is None:
        named = {f"j{label or 1}" if label.isdigit() or not label else label: pair for label, pair in pairs.items()}
        return named, "joint names from the log", by_order
    joints = robot.actuated
    known, unknown = [joint for joint in joints if joint in pairs], [name for name in pairs if name not in joints]
    some = known and not robot.closures and not any(name.isdigit() for name in unknown)
    if some or len(known) == len(joints):
        how = "positions matched by joint name, commands by column order" if by_order else "matched by joint name"
        return {joint: pairs[joint] for joint in known}, how, by_order
    if 0 < len(pairs) < len(joints) and len(chain := _chain(robot)) == len(pairs):
        joints = chain
    if len(pairs) < len(joints):
        listed = f" ({', '.join(pairs)})" if pairs and all(pairs) else ""
        raise GtauError(
            f"the log has positions and commands of {counted(len(pairs), 'joint')}{listed}, but robot "
            f"'{robot.name}' has {len(joints)} actuated ones; "
            + (f"name the columns after their joints (q_{joints[0]}), or " if not robot.closures else "")
            + "give matching logs and robot."
        )
    numbers = {joint: int(digits[-1]) for joint in joints if (digits := re.findall(r"\d+", joint))}
    how = "matched by column order"
    if len(set(numbers.values())) == len(joints):  # p4 p1 p2 p3 of the robot, 0 1 2 3 of the log
        by_number = tuple(sorted(joints, key=numbers.__getitem__))
        how = how if by_number == joints else "matched by the numbers in the joints' names"
        joints = by_number
    ordered = _ordered(pairs)
    assigned = {joint: pairs[label] for joint, label in zip(joints, ordered, strict=False)}
    return assigned, how, True


def renamed_labels(group: Group, joints: Sequence[str]) -> tuple[Group, dict[str, str]]:
    """Rename labels that are nearly a joint's name, and return these with the joints."""
    unknown = [label for label in group.columns if label not in joints and not label.isdigit()]
    renamed = resembling(unknown, [joint for joint in joints if joint not in group.columns])
    columns = {renamed.get(label, label): column for label, column in group.columns.items()}
    return replace(group, columns=columns), renamed


def _chain(robot: Robot) -> tuple[str, ...]:
    """List the actuated joints that carry the tool; none where another branch has as many."""
    chains: dict[str, tuple[str, ...]] = {}
    for joint in robot.joints:
        chains[joint.name] = chains.get(joint.antecedent, ()) + (joint.name,) * joint.actuated
    chain = chains.get(robot.tool, ())
    return chain if sum(len(branch) == len(chain) for branch in set(chains.values())) == 1 else ()


def _ordered(labels: Iterable[str]) -> list[str]:
    """Sort labels by number, if all have one."""
    labels = list(labels)
    return sorted(labels, key=int) if all(label.isdigit() for label in labels) else labels
