"""The same log in every format gives the same numbers; what cannot be read is refused in one sentence."""

from __future__ import annotations

import builtins
import gzip
import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from small_blocks import working_with

from gtau.errors import GtauError
from gtau.signals.reading.discovery import discover
from gtau.signals.reading.drafting import draft_text
from gtau.signals.reading.formats import readable
from gtau.signals.reading.formats.columnar import data_set
from gtau.signals.reading.logs import find_columns, read_log
from gtau.signals.reading.samples import Part
from gtau.signals.run import Run, read_run

N, RATE = 1500, 500.0
JOINTS = ("shoulder", "elbow")
TOPIC = "/joint_states"


@pytest.fixture(scope="module")
def log() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (N,), positions and efforts (N, 2); the time's nanoseconds are whole."""
    time = 7.0 + np.arange(N) / RATE
    angle = 2 * np.pi * 0.7 * time
    return time, np.column_stack([np.sin(angle), 0.3 * np.cos(angle)]), np.column_stack([np.cos(angle), angle % 1.3])


def signals(time: str, position: str, torque: str) -> dict:
    """Column patterns of the two joints; ``#`` is the number from 1, ``@`` the name."""
    columns = [
        {joint: pattern.replace("#", str(k + 1)).replace("@", joint) for k, joint in enumerate(JOINTS)}
        for pattern in (position, torque)
    ]
    return {"time": time, "position": columns[0], "torque": columns[1]}


Log = tuple[np.ndarray, np.ndarray, np.ndarray]


def csv(path: Path, log: Log) -> dict:
    np.savetxt(path, np.column_stack(log), delimiter=",", header="t,q1,q2,v1,v2", comments="")
    return signals("t", "q#", "v#")


def feather(path: Path, log: Log) -> dict:
    pl.DataFrame(np.column_stack(log), schema=["t", "q1", "q2", "v1", "v2"]).write_ipc(path)
    return signals("t", "q#", "v#")


def npz(path: Path, log: Log) -> dict:
    np.savez(path, t=log[0], q=log[1], tau=log[2].T, note="a text is not a signal", scale=3.0)
    return signals("t", "q[#]", "tau[#]")


def mat(path: Path, log: Log) -> dict:
    from scipy.io import savemat

    savemat(path, {"log": {"t": log[0], "arm": {"q": log[1], "tau": log[2]}}, "name": "arm", "empty": []})
    return signals("log.t", "log.arm.q[#]", "log.arm.tau[#]")


def mat73(path: Path, log: Log) -> dict:
    """As MATLAB writes it: HDF5 after 512 bytes, matrices transposed, a vector as a matrix of one row."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group["t"], group["q"], group["tau"] = log[0][None], log[1].T, log[2].T
        file["#refs#/a"] = log[1]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return signals("log.t", "log.q[#]", "log.tau[#]")


def hdf5(path: Path, log: Log) -> dict:
    import h5py

    with h5py.File(path, "w") as file:
        file["time"], file["arm/q"] = log[0], log[1]
        file.create_dataset("arm/tau", data=log[2], chunks=(100, 2), compression="gzip")
    return signals("time", "arm/q[#]", "arm/tau[#]")


def rosbag(path: Path, log: Log, storage: str = "SQLITE3", step: float = 0.0) -> dict:
    """Joint states, now and then in another order, beside a topic of a type that holds no numbers."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    state, text = "sensor_msgs/msg/JointState", "std_msgs/msg/String"
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        states = bag.add_connection(TOPIC, state, typestore=store)
        texts = bag.add_connection("/rosout", text, typestore=store)
        for k, (time, position, effort) in enumerate(zip(*log, strict=True)):
            nanoseconds = round(time * 1e9)
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
            order = slice(None, None, -1 if k % 10 == 3 else 1)
            message = kinds[state](
                kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
                list(JOINTS[order]),
                *(np.ascontiguousarray(each[order]) for each in (position, 0 * position, effort)),
            )
            bag.write(states, nanoseconds + 1000, store.serialize_cdr(message, state))
            if not k % 50:
                bag.write(texts, nanoseconds, store.serialize_cdr(kinds[text](data="hello"), text))
    return signals(f"{TOPIC}/header/stamp", f"{TOPIC}/@/position", f"{TOPIC}/@/effort")


def csv_gz(path: Path, log: Log) -> dict:
    np.savetxt(path, np.column_stack(log), delimiter=",", header="t,q1,q2,v1,v2", comments="")  # compressed by its name
    assert path.read_bytes().startswith(b"\x1f\x8b")
    return signals("t", "q#", "v#")


def npy(path: Path, log: Log) -> dict:
    table = np.empty(N, dtype=[("t", float), ("q", float, (2,)), ("tau", np.float64, (2,))])
    table["t"], table["q"], table["tau"] = log
    np.save(path, table)
    return signals("t", "q[#]", "tau[#]")


def npy_numbered(path: Path, log: Log) -> dict:
    np.save(path, np.column_stack(log).T)
    return signals("1", "#", "#") | {
        "position": {"shoulder": "2", "elbow": "3"},
        "torque": {"shoulder": "4", "elbow": "5"},
    }


def npz_named(path: Path, log: Log) -> dict:
    np.savez(path, data=np.column_stack(log), columns=np.array(["t", "q1", "q2", "v1", "v2"]), rate=RATE)
    return signals("t", "q#", "v#")


def npz_fields(path: Path, log: Log) -> dict:
    table = np.empty(N, dtype=[("t", float), ("q", float, (2,)), ("tau", np.float64, (2,))])
    table["t"], table["q"], table["tau"] = log
    np.savez(path, log=table)
    return signals("log.t", "log.q[#]", "log.tau[#]")


def json_lines(path: Path, log: Log) -> dict:
    columns = {
        "t": log[0],
        "arm": [{"q": q, "tau": {"1": a, "2": b}} for q, (a, b) in zip(log[1], log[2], strict=True)],
    }
    pl.DataFrame(columns).write_ndjson(path)
    return signals("t", "arm.q[#]", "arm.tau.#")


def tdms(path: Path, log: Log) -> dict:
    nptdms = pytest.importorskip("nptdms")
    names = ("q1", "q2", "v1", "v2")
    with nptdms.TdmsWriter(path) as file:
        for part in (slice(0, 700), slice(700, None)):
            arrays = np.column_stack(log[1:])[part].T
            channels = [nptdms.ChannelObject("arm", name, array) for name, array in zip(names, arrays, strict=True)]
            file.write_segment([*channels, nptdms.ChannelObject("arm", "t", log[0][part])])
    return signals("t", "q#", "v#")


def simulink(path: Path, log: Log) -> dict:
    """A structure with time, as the blocks To Workspace and Scope write it: one signal with a label, one without."""
    from scipy.io import savemat

    recorded = np.empty((1, 2), dtype=[("values", object), ("dimensions", object), ("label", object)])
    recorded[0, 0], recorded[0, 1] = (log[1], 2, "q"), (log[2].T[:, None], 2, "")
    savemat(path, {"out": {"time": log[0][:, None], "signals": recorded, "blockName": "model/Scope"}})
    return signals("out.time", "out.q.values[#]", "out.signals[2].values[#]")


def demonstrations(path: Path, log: Log) -> dict:
    """Groups of one run each, one after another; ``demo_10`` comes after ``demo_9``."""
    import h5py

    with h5py.File(path, "w") as file:
        for k, part in ((10, slice(600, None)), (9, slice(0, 600))):
            group = file.create_group(f"data/demo_{k}")
            group["t"], group["q"], group["tau"] = (array[part] for array in log)
            group["images"] = np.zeros((3, 2, 2))
    return signals("data/t", "data/q[#]", "data/tau[#]")


def mcap(path: Path, log: Log) -> dict:
    return rosbag(path, log, "MCAP")


FORMATS = {
    "log.feather": feather,
    "log.npz": npz,
    "log.mat": mat,
    "v73.mat": mat73,
    "log.h5": hdf5,
    "log.npy": npy,
    "numbers.npy": npy_numbered,
    "named.npz": npz_named,
    "fields.npz": npz_fields,
    "log.jsonl": json_lines,
    "log.tdms": tdms,
    "simulink.mat": simulink,
    "demos.h5": demonstrations,
    "bag": rosbag,
    "bag_mcap": mcap,
}


@pytest.mark.parametrize("name", ["log.csv.gz", *FORMATS])
def test_every_format_gives_the_same_numbers(tmp_path: Path, log: Log, name: str) -> None:
    """To the digits that were written: a bag holds nanoseconds."""
    csv(tmp_path / "log.csv", log)
    expected = read_run(tmp_path / "log.csv", signals("t", "q#", "v#"))
    columns = (FORMATS | {"log.csv.gz": csv_gz})[name](tmp_path / name, log)
    run = read_run(tmp_path / name, columns)
    assert (run.joints, run.kind, run.notes) == (JOINTS, "torque", ())
    np.testing.assert_allclose(run.time, expected.time, atol=1e-9)
    np.testing.assert_allclose(run.position, expected.position, atol=1e-15)
    np.testing.assert_allclose(run.command, expected.command, atol=1e-15)


@pytest.mark.parametrize("name", FORMATS)
def test_blocks_and_parts_are_those_of_the_whole(tmp_path: Path, log: Log, name: str) -> None:
    columns = FORMATS[name](tmp_path / name, log)
    names = [columns["time"], *columns["position"].values()]
    file = read_log(tmp_path / name, names)
    with working_with(400):
        blocks = list(file.blocks())
    assert [len(values) for values, _ in blocks] == [400, 400, 400, 300]
    assert blocks[-1][1] == 1.0
    np.testing.assert_allclose(np.vstack([values for values, _ in blocks])[:, 1:], log[1], atol=1e-15)
    part = np.vstack([values for values, _ in file.blocks(range(350, 1250))])
    np.testing.assert_allclose(part[:, 1:], log[1][350:1250], atol=1e-15)


def test_a_bag_without_its_metadata_and_a_pattern_of_bags(tmp_path: Path, log: Log) -> None:
    columns = rosbag(tmp_path / "bag", log)
    (storage,) = (tmp_path / "bag").glob("*.db3")
    np.testing.assert_array_equal(read_run(storage, columns).position, read_run(tmp_path / "bag", columns).position)
    assert f"{TOPIC}/received" in find_columns(storage).columns
    received = read_log(storage, [f"{TOPIC}/received"]).arrays()[f"{TOPIC}/received"]
    np.testing.assert_allclose(received, log[0] + 1e-6, atol=1e-9)


def test_the_panda_bag_is_what_others_decoded(shared: Path) -> None:
    folder = shared / "panda_rosbag2"
    joints = [f"fer_joint{k}" for k in range(1, 8)]
    names = [
        f"{TOPIC}/header/stamp",
        *(f"{TOPIC}/{joint}/{field}" for field in ("position", "effort") for joint in joints),
    ]
    bag = read_log(folder / "panda_exciting_trajectory.db3", names).arrays()
    decoded = read_log(
        folder / "panda_exciting_trajectory.csv", ["t", *(f"{k}_{j}" for k in ("q", "effort") for j in joints)]
    )
    for ours, theirs in zip(bag.values(), decoded.arrays().values(), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-8)  # nine digits were written


DAMAGED: list[tuple[str, bytes, str]] = [
    ("log.npz", b"no archive", "log.npz cannot be read as a NumPy archive ("),
    ("log.mat", b"MATLAB 5.0 MAT-file, but cut" * 9, "log.mat cannot be read as a MAT file ("),
    (
        "log.mat",
        b"\0" * 512 + b"\x89HDF\r\n\x1a\n and no more",
        "log.mat cannot be read as a MAT file of version 7.3",
    ),
    ("log.h5", b"\x89HDF\r\n\x1a\n cut", "log.h5 cannot be read as an HDF5 file ("),
    ("log.db3", b"SQLite format 3\0 cut", "log.db3 cannot be read as a ROS bag ("),
    ("log.mcap", b"\x89MCAP0\r\n cut", "log.mcap cannot be read as a ROS bag ("),
    ("log.npy", b"\x93NUMPY cut", "log.npy cannot be read as a NumPy array ("),
    ("log.jsonl", b'{"t": 1}\n{"t": ', "log.jsonl is not a readable JSON lines file ("),
    ("log.tdms", b"no such file of LabVIEW" * 9, "log.tdms cannot be read as a TDMS file ("),
    ("log.csv.gz", gzip.compress(b"t,q,v\n1,2,3\n" * 999, mtime=0)[:18], "log.csv.gz cannot be unpacked ("),
    ("log.csv.gz", b"t,q,v\n1,2,3\n", "log.csv.gz cannot be unpacked ("),
    ("log.feather", b"ARROW1 cut", "log.feather is not a readable Feather file ("),
]


@pytest.mark.parametrize(("name", "content", "sentence"), DAMAGED)
def test_damaged_files_are_refused_in_one_sentence(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(GtauError) as refusal:
        read_log(tmp_path / name, ["t"])
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_pickles_are_refused(tmp_path: Path, log: Log) -> None:
    np.savez(tmp_path / "log.npz", run=np.array([{"t": 1}], dtype=object))
    with pytest.raises(GtauError, match=r"holds pickled objects \('run'\), which are not read as they can run code"):
        read_log(tmp_path / "log.npz", ["t"])
    np.save(tmp_path / "log.npy", np.array([{"t": 1}], dtype=object))
    with pytest.raises(GtauError, match=r"log\.npy cannot be read as a NumPy array \(.*objects in dtype\)"):
        read_log(tmp_path / "log.npy", ["t"])


def test_each_demonstration_is_a_run(tmp_path: Path, log: Log) -> None:
    columns = demonstrations(tmp_path / "demos.h5", log)
    run = read_run(tmp_path / "demos.h5", columns, part=Part(episode=10))
    np.testing.assert_allclose(run.position, log[1][600:], atol=1e-15)
    with pytest.raises(GtauError, match="has no episode 3; its episodes are 9 to 10"):
        read_run(tmp_path / "demos.h5", columns, part=Part(episode=3))
    draft = discover([tmp_path / "demos.h5"])
    assert (draft.signals.time, draft.signals.position) == ("data/t", {"j1": "data/q[1]", "j2": "data/q[2]"})
    assert [f"episode: {k}" in draft_text(draft, tmp_path) for k in (9, 10)] == [True, True]


def test_waveforms_and_dates_of_labview(tmp_path: Path, log: Log) -> None:
    """Channels may have a step in place of a time, units, and dates that are not numbers."""
    nptdms = pytest.importorskip("nptdms")
    dates = np.datetime64("2026-11-29T09:11:24") + (2000 * np.arange(N)).astype("timedelta64[us]")
    step = {"wf_increment": 1 / RATE, "wf_samples": 1, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(tmp_path / "log.tdms") as file:
        for name, array in (("q1", np.rad2deg(log[1][:, 0])), ("v1", log[2][:, 0])):
            unit = {"unit_string": "deg" if name == "q1" else "Nm"}
            file.write_segment([nptdms.ChannelObject("arm", name, array, properties=step | unit)])
        file.write_segment([nptdms.ChannelObject("dates", "stamp", dates)])
    entries = {"position": {"a": "arm/q1"}, "torque": {"a": "arm/v1"}}
    for time in ("arm/time", "dates/stamp"):
        run = read_run(tmp_path / "log.tdms", {"time": time, **entries}, units={"position": "deg"})
        np.testing.assert_allclose(run.time - run.time[0], log[0] - log[0][0], atol=1e-6)
        np.testing.assert_allclose(run.position[:, 0], log[1][:, 0], atol=1e-12)
    with pytest.raises(GtauError, match="'arm/q1' is in 'deg' by the log"):
        read_run(tmp_path / "log.tdms", {"time": "arm/time", **entries})


@pytest.mark.parametrize(
    ("write", "name", "package", "extra"),
    [
        (tdms, "log.tdms", "nptdms", "tdms"),
        (rosbag, "bag", "rosbags", "ros"),
        (hdf5, "log.h5", "h5py", "hdf5"),
        (mat73, "v73.mat", "h5py", "hdf5"),
    ],
)
def test_a_missing_extra_is_named_with_its_command(
    tmp_path: Path, log: Log, write: Callable, name: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = write(tmp_path / name, log)
    real = builtins.__import__

    def without(module: str, *rest: object, **more: object) -> object:
        if module.split(".")[0] == package:
            raise ImportError(module)
        return real(module, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(GtauError, match=rf"needs the package {package}.*pip install 'gtau\[{extra}\]'"):
        read_run(tmp_path / name, columns)


def test_files_without_numbers(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", note="no numbers", scale=2.0)
    with pytest.raises(
        GtauError, match=r"log\.npz holds no columns of numbers; save the signals as plain numeric arrays"
    ):
        read_log(tmp_path / "log.npz", ["t"])


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_that_are_not_asked_for_are_not_read(tmp_path: Path, log: Log, save: Callable[..., None]) -> None:
    save(tmp_path / "log.npz", t=log[0], q=log[1], tau=log[2], image=np.zeros((4_000_000, 5)))
    tracemalloc.start()
    read_run(tmp_path / "log.npz", signals("t", "q[#]", "tau[#]"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6  # of 160 MB


def test_variables_of_a_mat_file_that_are_not_asked_for_are_not_read(
    tmp_path: Path, log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    import scipy.io

    content = {"t": log[0], "log": {"q": log[1], "tau": log[2]}, "phase": log[0] * 1j, "image": np.zeros((40_000, 5))}
    scipy.io.savemat(tmp_path / "log.mat", content)
    read, load = [], scipy.io.loadmat
    monkeypatch.setattr(scipy.io, "loadmat", lambda *path, **how: read.append(load(*path, **how)) or read[-1])
    run = read_run(tmp_path / "log.mat", signals("t", "log.q[#]", "log.tau[#]"))
    np.testing.assert_array_equal(run.position, log[1])
    assert {name for each in read for name in each if not name.startswith("__")} == {"t", "log"}
    with pytest.raises(GtauError, match="'phase' holds complex numbers; give a column of real ones"):
        list(read_log(tmp_path / "log.mat", ["phase"]).blocks())


def test_columns_of_different_length(tmp_path: Path, log: Log) -> None:
    np.savez(tmp_path / "log.npz", t=log[0], q=log[1], tau=log[2][:-7])
    with pytest.raises(GtauError, match=r"'t' has 1500 rows but 'tau\[1\]' has 1493; give columns that were sampled"):
        read_run(tmp_path / "log.npz", signals("t", "q[#]", "tau[#]"))


def stamps(run: Run) -> tuple[float, float]:
    return float(run.time[0]), float(run.time[-1])


@pytest.fixture
def topics(tmp_path: Path) -> Callable[[np.ndarray, np.ndarray], list[Path]]:
    """Writes one text file a topic, its time in seconds and nanoseconds."""

    def write(of_position: np.ndarray, of_command: np.ndarray) -> list[Path]:
        paths = []
        for name, time, wave in (("position", of_position, np.sin), ("command", of_command, np.cos)):
            nanoseconds = np.round(time * 1e9).astype(np.int64)
            rows = [f"{n // 10**9}\t{n % 10**9}\t{x:.9f}" for n, x in zip(nanoseconds, wave(3 * time), strict=True)]
            paths.append(tmp_path / f"{name}.txt")
            paths[-1].write_text("\n".join([f"sec\tnsec\t{name}", *rows]) + "\n")
        return paths

    return write


PAIR = {"time": ["sec", "nsec"], "position": {"a": "position"}, "torque": {"a": "command"}}
EACH = PAIR | {"time": {"position": ["sec", "nsec"], "command": ["sec", "nsec"]}}


def test_time_in_two_columns(topics: Callable) -> None:
    time = 1000.0 + np.arange(N) / RATE
    run = read_run(topics(time, time), PAIR)
    assert run.notes == ()
    np.testing.assert_allclose(run.time, time, atol=1e-9)
    np.testing.assert_allclose(run.position[:, 0], np.sin(3 * time), atol=1e-9)


def test_topics_with_stamps_of_their_own_are_aligned(topics: Callable, rng: np.random.Generator) -> None:
    """On lines: a sine of 3 rad/s sampled each 4 ms lies within (3 * 0.004)^2 / 8 of them."""
    time, other = 1000.0 + np.arange(N) / RATE, 1000.1013 + np.arange(600) / 250
    run = read_run(topics(time, other), EACH)
    (note,) = run.notes
    assert str(note) == (
        "aligned the torques with the positions by linear interpolation between their stamps (250 Hz; positions "
        "500 Hz; typically 1.3 ms from a position to the nearest); left out 302 positions before the first or after "
        "the last of them"
    )
    assert stamps(run) == pytest.approx((1000.102, 1002.496), abs=1e-6)
    np.testing.assert_allclose(run.position[:, 0], np.sin(3 * run.time), atol=1e-8)
    np.testing.assert_allclose(run.command[:, 0], np.cos(3 * run.time), atol=2e-5)


def test_equal_stamps_are_left_as_they_are(topics: Callable) -> None:
    time = 1000.0 + np.arange(N) / RATE
    run = read_run(topics(time, time), EACH)
    assert run.notes == ()
    np.testing.assert_allclose(run.command[:, 0], np.cos(3 * time), atol=1e-8)


def test_commands_that_pause_are_missing_there(topics: Callable) -> None:
    time = 1000.0 + np.arange(N) / RATE
    run = read_run(topics(time, np.delete(time, slice(700, 710))), EACH)
    assert "dropped 10 rows with missing or non-numeric values" in str(run.notes[0])
    assert np.flatnonzero(~run.valid[:, 0]).tolist() == list(range(700, 710))


def test_two_clocks_are_refused(topics: Callable) -> None:
    time = 1000.0 + np.arange(N) / RATE
    with pytest.raises(GtauError) as refusal:
        read_run(topics(time, time - 900), EACH)
    assert "holds positions from 1000 s to 1002.998 s, but" in str(refusal.value)
    assert "torques from 100 s to 102.998 s: their clocks do not overlap; log both with one clock" in str(refusal.value)


def test_commands_whose_time_goes_back(topics: Callable) -> None:
    time = 1000.0 + np.arange(N) / RATE
    with pytest.raises(GtauError, match=r"command.txt, line 702: the time of the torques goes back; cut the log there"):
        read_run(topics(time, np.r_[time[:700], time[600:]]), EACH)


def test_topics_of_different_length_name_the_way_out(topics: Callable) -> None:
    time = 1000.0 + np.arange(N) / RATE
    with pytest.raises(GtauError, match=r"or the stamps of each \(time: \{position: COLUMN, command: COLUMN\}\)"):
        read_run(topics(time, time[:-3]), PAIR)


def nested(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("/".join("g" * 100), data=np.zeros(3))


def crowded(path: Path) -> None:
    np.savez(path, **{f"a{k}": np.zeros(1) for k in range(6000)})


def empty(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("t\x1b\n", shape=(10**12,), chunks=(1024,), dtype="f8")


def elsewhere(path: Path) -> None:
    import h5py

    os.mkfifo(path.with_name("pipe"))
    with h5py.File(path, "w") as file:
        file.create_dataset("t", shape=(100,), dtype="f8", external=[(str(path.with_name("pipe")), 0, 800)])


def of_pipes(path: Path) -> None:
    (path / "data" / "chunk-000").mkdir(parents=True)
    pl.DataFrame({"t": [0.0]}).write_parquet(path / "data" / "chunk-000" / "file-000.parquet")
    os.mkfifo(path / "data" / "chunk-000" / "file-001.parquet")


def described(path: Path) -> None:
    of_pipes(path.with_name("pipes"))
    frames = path.with_name("pipes") / "data" / "chunk-000" / "file-000.parquet"
    (path / "meta").mkdir(parents=True)
    frames.rename(path / "file-000.parquet")
    (path / "meta" / "info.json").write_text("[" * 100_000)


def wide(path: Path) -> None:
    path.write_text("\n".join(",".join("1" * 30_000) for _ in range(5)))


@pytest.mark.parametrize(
    ("name", "save", "sentence"),
    [
        ("log.h5", nested, "log.h5: its groups are nested more than 32 deep"),
        ("log.npz", crowded, "log.npz: it holds more than 5000 arrays"),
        ("log.h5", empty, r"log.h5: 't\x1b\n' is said to hold 1000000000000 numbers, more than the file can"),
        ("log.h5", elsewhere, "log.h5: the values of 't' are in other files"),
        ("set", of_pipes, "file-001.parquet is a device or a pipe, not a file"),
        ("set", described, "info.json is not a readable description"),
        ("log.csv", wide, "log.csv: it has 30000 columns, and at most 20000 are read"),
    ],
)
def test_files_beyond_all_bounds_are_refused(
    name: str, save: Callable[[Path], None], sentence: str, tmp_path: Path
) -> None:
    save(tmp_path / name)
    with pytest.raises(GtauError) as refused:
        data_set(tmp_path / name, find_columns(tmp_path / name).columns)
    assert sentence in str(refused.value)


def test_a_length_beyond_the_memory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="asks for more memory than there is"), readable(tmp_path, "a ROS bag"):
        raise MemoryError
