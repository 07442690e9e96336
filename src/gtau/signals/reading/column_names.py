"""Column names: signal kind and joint of a name, columns grouped by these, and groups matched with a robot's joints.

The names are in the recorders' sources: libfranka ``log.cpp`` (time in ms, ``state.q[0]`` ...), Universal Robots' RTDE
client (``timestamp``, ``actual_q_0`` ...), and PlotJuggler's parser of ``sensor_msgs/JointState``. Drivers put into
``effort``: UR's ROS 2 driver (#1551) currents, or torques without gravity; franka_ros2 and ros2_kortex torques of the
joints' sensors, with gravity. LeRobot's data sets hold the lists; currents in them come from a plugin.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher

from gtau.documents.markup import own_table
from gtau.errors import GtauError
from gtau.findings import counted
from gtau.robots.robot import Robot
from gtau.signals.channel import SIDE_SIGNALS, SUPPLY
from gtau.signals.reading.units import WrittenUnit, read_unit, split_unit

WORDS = {kind: frozenset(words.split()) for kind, words in own_table(__file__, "column_words.yaml").items()}
SIDE = frozenset[str]().union(SUPPLY, *(signal.words for signal in SIDE_SIGNALS))
WORDS["other"] |= SIDE - WORDS["time"] - WORDS["current"]  # temps
PRECEDENCE: tuple[str, ...] = ("other", "acceleration", "velocity", "current", "torque", "position", "motor", "time")
REFERENCE, MEASURED = WORDS["reference"], WORDS["measured"]
POSE = frozenset(["pose", "tcp", "mocap", "cartesian", "flange", "tracker", "quaternion", "quat"])
SENSOR = frozenset(["sensor", "sensors", "sensed", "jts"])  # of torque, between gear and link
COMPOUND = re.compile(  # German: Gelenkwinkel, Iststrom, Lageistwert
    "(ist|soll|motor|gelenk|achs|strom|lage|positions?|winkel|drehmoment|drehzahl|geschwindigkeits?)"
    "(?=ist|soll|strom|winkel|lage|position|drehmoment|moment|geschw|drehzahl)"
)
COMMAND = frozenset(["v", "u", "control", "action", "command", "load"])  # currents or torques, unless velocities
NO_UNIT = frozenset[str]().union(*WORDS.values())  # words in brackets
JOINT_KINDS = ("position", "velocity", "acceleration", "current", "torque")
JOINT_WORDS = frozenset(
    ["joint", "joints", "axis", "axes", "link", "motor", "actual", "state", "states", "drive", "encoder"]
)
SIGNAL_WORDS = NO_UNIT | COMMAND | JOINT_WORDS
SIDE_BY_SIDE = re.compile(  # words of languages that write them so: the longest come first
    "|".join(sorted((word for word in NO_UNIT if not word.isascii()), key=len, reverse=True))
)
ALIKE = 0.85  # of letters in two names of a joint: elbo and elbow 0.89, ellbow 0.91; fl_hip and fr_hip 0.80
BARE = re.compile(r"((joint|axis|axe|achse|eje|asse|jnt|j|a)[_ .]?)?#", re.IGNORECASE)  # a joint and no signal
AROUND = re.compile(r"#[_ ]joint(?![A-Za-z])|(?<![A-Za-z])joint[_ ]#", re.IGNORECASE)


@dataclass(frozen=True)
class ColumnName:
    """A parsed column ``name``: its remainder without the joint, the joint's label, the kind and the unit.

    ``kind`` is one of ``WORDS``, ``command`` (a current, torque or velocity), ``sensor`` (of torque), or None;
    ``motor`` is a motor torque, or a column merely named after a motor; a ``reference`` is a setpoint.
    """

    name: str
    stem: str
    label: str
    kind: str | None
    reference: bool
    unit: str | None

    def names_joint(self, joints: Sequence[str]) -> bool:
        """Return whether it names a joint and no signal: one of the ``joints`` or, after ``axis`` or alike, any."""
        return self.kind is None and bool(BARE.fullmatch(self.stem)) and (self.stem != "#" or self.label in joints)


def split_name(name: str, joints: Sequence[str], unit: str | None) -> tuple[str, str, WrittenUnit | None]:
    """Split a name into the joint in it, the rest (with ``#`` for the joint), and the unit, which may be known."""
    label, bare = "", name
    for joint in sorted(joints, key=len, reverse=True):
        before = r"(?<!\d)" if joint.isdigit() else r"(?<![A-Za-z0-9])[A-Za-z]{0,3}?"  # q11; qleft as well as q_left
        match = re.search(rf"{before}({re.escape(joint)})(?![A-Za-z0-9])", name, re.IGNORECASE)
        if match:
            label, bare = joint, name[: match.start(1)] + "#" + name[match.end(1) :]
            break
    bare, written = split_unit(bare, NO_UNIT)
    return label, bare, (read_unit(unit) or WrittenUnit(None, unit)) if unit else written


def parse_column_name(name: str, joints: Sequence[str] = (), unit: str | None = None) -> ColumnName:
    """Parse the name of a column with the names of ``joints`` in it, and the ``unit`` that the log gives elsewhere."""
    label, bare, written = split_name(name, joints, unit)
    stem, words = bare, list[str]()
    if re.fullmatch(r"/.*/(stamp|received)", name):
        label, stem, words = "", name, ["timestamp"]  # of a topic of a bag, perhaps of one joint
    elif label:
        pass
    elif match := re.fullmatch(r"(observation\.state\[)(\d+)\]", bare):  # LeRobot's positions
        label, stem, words = match[2], f"{match[1]}#]", ["position"]
    elif re.fullmatch(r"/.*/[^/]+/[^/\]]+", bare):  # /joint_states/elbow/position
        *topic, label, field = bare.split("/")
        stem, words = "/".join([*topic, "#", field]), _words(field)
    elif match := re.search(r"^(.*?)(\d+)(\D*)$", bare):
        label, stem = match[2], f"{match[1]}#{match[3]}"
    else:
        label, stem = _named(bare)
    words = words or _words(stem)
    kind = next((kind for kind in PRECEDENCE if not WORDS[kind].isdisjoint(words)), None)
    if kind == "current" and {"as", "torque"} <= set(words):  # of UR: actual_current_as_torque
        kind = "torque"
    elif kind == "torque" and not SENSOR.isdisjoint(words):
        kind = "sensor"
    elif kind == "torque" and not WORDS["motor"].isdisjoint(words):
        kind = "motor"
    if kind is None and not COMMAND.isdisjoint(words):
        kind = "command"
    measures, text = written or (None, "")
    reference = not REFERENCE.isdisjoint(words) or (measures == "position" and kind == "command")
    kind = kind if kind == "other" else _by_unit(kind, measures)
    return ColumnName(name, stem, label, kind, reference, text or None)


def _named(name: str) -> tuple[str, str]:
    """Split a name into its only part that is not a word of signals (``elbow`` in ``elbow_pos``) and the stem."""
    words = [(match.span(), _words(match[0])) for match in re.finditer(r"[A-Z]+(?![a-z])|[A-Z]?[^\W\d_A-Z]+|\d+", name)]
    odd = [k for k, (_, word) in enumerate(words) if SIGNAL_WORDS.isdisjoint(word)]
    has_kind = any(not WORDS[kind].isdisjoint(word) for _, word in words for kind in JOINT_KINDS)
    if not odd or not has_kind or odd[-1] - odd[0] >= len(odd) or not WORDS["other"].isdisjoint(_words(name)):
        return "", name
    start, stop = words[odd[0]][0][0], words[odd[-1]][0][1]
    return name[start:stop], f"{name[:start]}#{name[stop:]}"


def _by_words(name: ColumnName) -> ColumnName | None:
    """Relabel a name by all its words that are not words of signals, and ``joint`` beside them; None without such."""
    label, stem = _named(name.stem.replace("#", name.label, 1))
    if label and (around := AROUND.search(stem)):
        label, stem = around[0].replace("#", label), stem.replace(around[0], "#")
    return replace(name, label=label, stem=stem) if label and name.kind not in (None, "other") else None


@dataclass(frozen=True)
class Group:
    """Columns of one kind of signal, one for each joint, by the joint's label in their names."""

    kind: str | None
    stem: str
    columns: dict[str, str]
    reference: bool = False
    unit: str | None = None
    in_order: bool = False  # of the joints, as stated

    @property
    def assumed(self) -> bool:
        """Whether it is taken for positions although its names name a joint alone."""
        return self.kind == "position" and self.unit is None and BARE.fullmatch(self.stem) is not None

    @property
    def first(self) -> str:
        """Its first column."""
        return next(iter(self.columns.values()))

    @property
    def listed(self) -> str:
        """Short list of the columns: the first and the last."""
        names = list(self.columns.values())
        return names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"


def grouped(names: Sequence[ColumnName]) -> list[Group]:
    """Group columns but time by their stems; a second column of a joint, in another unit, is separate."""
    names = [name for name in names if name.kind != "time"]
    stems = Counter(name.stem.casefold() for name in names)
    renamed = {name: name_ for name in names if stems[name.stem.casefold()] == 1 and (name_ := _by_words(name))}
    stems += Counter(name.stem.casefold() for name in renamed.values())
    groups: dict[str, Group] = {}
    for parsed in names:
        name = renamed.get(parsed, parsed)
        name = name if stems[name.stem.casefold()] > 1 else parsed
        stem = name.stem.casefold()
        if stem in groups and name.label in groups[stem].columns:
            stem += f" [{name.unit}]"
        group = groups.setdefault(stem, Group(name.kind, name.stem, {}, name.reference, name.unit))
        group.columns[name.label] = name.name
    return list(groups.values())


def resembling(labels: Sequence[str], joints: Sequence[str]) -> dict[str, str]:
    """Match labels with joints of nearly the same name, such as ``elbo`` or ``elbow_lift``, if only one joint fits."""

    def similar_names(label: str, joint: str) -> bool:
        parts = [re.findall(r"[a-z]+|\d+", name.lower()) for name in (label, joint)]
        names = [[word for word in words if word not in JOINT_WORDS] for words in parts]
        a, b = map(set, names)
        numbers = [{word for word in words if word.isdigit()} for words in (a, b)]
        if not a or not b or (all(numbers) and numbers[0] != numbers[1]):
            return False
        return a <= b or b <= a or SequenceMatcher(None, "".join(names[0]), "".join(names[1])).ratio() >= ALIKE

    candidates = {label: [joint for joint in joints if similar_names(label, joint)] for label in labels}
    counts = Counter(joint for similar in candidates.values() for joint in similar)
    return {label: similar[0] for label, similar in candidates.items() if len(similar) == 1 == counts[similar[0]]}


def _by_unit(kind: str | None, measures: str | None) -> str | None:
    """Correct the kind of a column, as its name says, by what its unit measures."""
    kept = {"position": "position velocity", "current": "current torque motor", "torque": "torque sensor motor"}
    corrected = {"position": "motor command", "current": "command", "torque": "command current position"}
    if measures is None or measures == "share":
        return kind
    if kind in (None, measures) or measures not in {"time", *kept} or kind in corrected.get(measures, "").split():
        return measures
    return kind if kind in kept.get(measures, "").split() else "other"


def parse_item(column: str, label: str, joints: Sequence[str] = ()) -> ColumnName:
    """Parse the name of a list item, ``FEATURE/NAME`` as in LeRobot: ``observation.state/elbow.pos`` is a position."""
    feature, _, name = label.partition("/")
    joint, _, quantity = name.rpartition(".")
    quantity = quantity if joint else feature.rpartition(".")[2]
    field = "position" if quantity == "state" else quantity
    column_name = parse_column_name(f"/{feature}/{joint or name}/{field}", joints)
    return replace(column_name, name=column, reference=column_name.reference or feature == "action")


def has_word(name: str, words: frozenset[str]) -> bool:
    """Decide whether the name of a column holds one of some words, such as ``MEASURED`` or ``POSE``."""
    return not words.isdisjoint(_words(name))


def _words(text: str) -> list[str]:
    plain = "".join(letter for letter in unicodedata.normalize("NFD", text) if not unicodedata.combining(letter))
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|°", plain)]
    words = [part for word in words for part in COMPOUND.sub(r"\1 ", word).split()]
    return words + SIDE_BY_SIDE.findall(unicodedata.normalize("NFKC", text))


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
        positions, names = renamed_labels(positions, robot.actuated)
        commands, more = renamed_labels(commands, robot.actuated)
        names |= more
    pairs, how, by_order = _pairs(positions, commands, robot)
    how += f", {positions.listed} taken for positions" * positions.assumed
    how += "".join(f", {label} taken for {joint}" for label, joint in names.items())
    columns, currents = ({joint: pair[k] for joint, pair in pairs.items()} for k in (0, 1))
    logged = {joint: labels[column] for joint, column in columns.items()}
    return columns, currents, logged, how, not (by_order or names or positions.assumed)


def _pairs(positions: Group, commands: Group, robot: Robot | None) -> tuple[dict[str, tuple[str, str]], str, bool]:
    """Pair columns of positions and commands by joint; say how they were matched, and whether by their order alone."""
    common = [label for label in positions.columns if label in commands.columns]
    labels = [(label, label) for label in common]
    by_order = not common and len(positions.columns) == len(commands.columns)
    if by_order:
        labels = list(zip(*(_ordered(group.columns, group.in_order) for group in (positions, commands)), strict=True))
    pairs = {q: (positions.columns[q], commands.columns[v]) for q, v in labels}
    if robot is None:
        named = {f"j{label or 1}" if label.isdigit() or not label else label: pair for label, pair in pairs.items()}
        return named, "joint names from the log", by_order
    joints = robot.actuated
    known = [joint for joint in joints if joint in pairs]
    some = known and not robot.closures and not any(name.isdigit() for name in pairs if name not in joints)
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
    if len(set(numbers.values())) == len(joints) and not positions.in_order:
        # p4 p1 p2 p3 of the robot, 0 1 2 3 of the log
        by_number = tuple(sorted(joints, key=numbers.__getitem__))
        how = how if by_number == joints else "matched by the numbers in the joints' names"
        joints = by_number
    ordered = _ordered(pairs, positions.in_order)
    return {joint: pairs[label] for joint, label in zip(joints, ordered, strict=False)}, how, True


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


def _ordered(labels: Iterable[str], in_order: bool) -> list[str]:
    """Sort labels that are not ``in_order`` by the last numbers in them if all have one of their own."""
    labels = list(labels)
    numbers = {label: int(digits[-1]) for label in labels if (digits := re.findall(r"\d+", label))}
    numbered = not in_order and len({*numbers.values()}) == len(labels)
    return sorted(labels, key=numbers.__getitem__) if numbered else labels


def topics_of(columns: Sequence[str]) -> list[str]:
    """List the topics of a bag by its columns, the longest first."""
    topics = [name.removesuffix("/received") for name in columns if re.fullmatch("/.*/received", name)]
    return sorted(topics, key=len, reverse=True)


def of_topics(names: Sequence[ColumnName], topics: Sequence[str], main: str | None) -> list[ColumnName]:
    """Select the columns of a topic, and of topics like it where each of them has one joint."""
    by_topic = {topic: [name for name in names if topic_of(name.name, topics) == topic] for topic in topics}
    fields = {topic: [*map(_field, some, [topic] * len(some))] for topic, some in by_topic.items()}
    chosen = by_topic.get(main or "", [])
    alike = [topic for topic in topics if main and sorted(fields[topic]) == sorted(fields[main])]
    if len(alike) < 2 or len({name.label for name in chosen if name.kind == "position"}) != 1:
        return chosen
    alike = [str(main), *(topic for topic in reversed(topics) if topic in alike and topic != main)]
    parts = zip(*(topic.split("/") for topic in alike), strict=False)
    places = [k for k, words in enumerate(parts) if len({*words}) == len(alike)]
    if not places:
        return chosen
    labels = {topic: topic.split("/")[places[0]] for topic in alike}
    return [
        name if name.kind == "time" else replace(name, label=labels[topic], stem=field)
        for topic in alike
        for name, field in zip(by_topic[topic], fields[topic], strict=True)
    ]


def _field(name: ColumnName, topic: str) -> str:
    """Write the field of a column of a topic, without the joint in it."""
    return name.name.removeprefix(f"{topic}/").replace(name.label, "#") if name.label else name.name[len(topic) + 1 :]


def topic_of(name: str, topics: Sequence[str]) -> str:
    """Find the topic of a column, empty where it is of none."""
    return next((topic for topic in topics if name.startswith(f"{topic}/")), "")
