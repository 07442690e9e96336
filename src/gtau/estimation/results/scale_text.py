"""What the scale of the drive gains rests on, in words."""

from __future__ import annotations

from collections.abc import Mapping

from gtau.estimation.results.identified_model import IdentifiedModel

LEAST = 0.01  # share of a source that is mentioned


def scale_lines(result: IdentifiedModel, masses: bool = False) -> list[str]:
    """Describe what the scale of all gains rests on, or of each where they differ; empty where they were given.

    With ``masses``, payloads are named with theirs.
    """
    names = _sensors(result)
    if masses:
        known = {each.name: each.parameters["m"].value for each in result.payloads if "m" in each.known}
        names |= {f"payload '{name}'": f"payload '{name}' ({mass:g} kg)" for name, mass in known.items()}
    words = {joint: _words(gain.scale, names) for joint, gain in result.drive_gains.items() if gain.scale}
    if not words:
        return []
    if len(set(words.values())) == 1:
        return [f"The scale of all gains rests on {next(iter(words.values()))}."]
    return [f"The scale of '{joint}' rests on {each}." for joint, each in words.items()]


def all_sources(result: IdentifiedModel) -> str:
    """List all sources of the scale, those on which most gains rest first; torque sensors together, joint by joint."""
    totals: dict[str, float] = {}
    for gain in result.drive_gains.values():
        for source, share in gain.scale.items():
            totals[source] = totals.get(source, 0.0) + abs(share) / len(result.drive_gains)
    found = [source for source, each in sorted(totals.items(), key=lambda each: -each[1]) if each >= LEAST]
    names = _sensors(result)
    sensors = [f"'{joint}'" for joint, source in zip(result.robot.actuated, names, strict=True) if source in found]
    if len(sensors) < 2:
        return " and ".join(names.get(source, source) for source in found)
    others = [source for source in found if source not in names]
    return " and ".join([f"the torque sensors of {', '.join(sensors)}", *others])


def _sensors(result: IdentifiedModel) -> dict[str, str]:
    """Name the torque sensors of all joints, by the source of a scale that each is."""
    return {f"torque sensor of '{joint}'": f"the torque sensor of '{joint}'" for joint in result.robot.actuated}


def _words(scale: Mapping[str, float], names: Mapping[str, str]) -> str:
    """Name the source of a scale, or several with their shares, the largest first."""
    listed = sorted((each for each in scale.items() if abs(each[1]) >= LEAST), key=lambda each: -each[1])
    if len(listed) == 1:
        return names.get(listed[0][0], listed[0][0])
    return ", ".join(f"{names.get(source, source)} ({100 * share:.0f} %)" for source, share in listed)
