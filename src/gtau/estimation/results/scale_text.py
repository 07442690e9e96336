"""What the scale of the drive gains rests on, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gtau.estimation.results.identified_model import IdentifiedModel

LEAST = 0.01  # share of a source that is mentioned
SENSOR = "torque sensor of "


def scale_words(scale: Mapping[str, float]) -> str:
    """Name the source of the scale, as ``payload 'steel'``, or several with their shares, the largest first."""
    listed = sorted((each for each in scale.items() if abs(each[1]) >= LEAST), key=lambda each: -each[1])
    if len(listed) == 1:
        return _named(listed[0][0])
    return ", ".join(f"{_named(source)} ({100 * share:.0f} %)" for source, share in listed)


def scale_lines(result: IdentifiedModel) -> list[str]:
    """Describe what the scale of all gains rests on, or of each where they differ; empty where they were given."""
    words = {joint: scale_words(gain.scale) for joint, gain in result.drive_gains.items() if gain.scale}
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
    found: Sequence[str] = [
        source for source, each in sorted(totals.items(), key=lambda each: -each[1]) if each >= LEAST
    ]
    sensors = [f"'{joint}'" for joint in result.robot.actuated if f"{SENSOR}'{joint}'" in found]
    if len(sensors) > 1:
        others = [each for each in found if not each.startswith(SENSOR)]
        found = [f"torque sensors of {', '.join(sensors)}", *others]
    return " and ".join(map(_named, found))


def _named(source: str) -> str:
    return f"the {source}" if source.startswith("torque") else source
