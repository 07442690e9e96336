"""``gtau mcp``: an agent's client starts it, calls its tools and reads its pages."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.demo import write_tutorial
from gtau.documents.files import hold_folder
from gtau.errors import GtauError
from gtau.pages import explain, pages

mcp = pytest.importorskip("mcp", reason="the package mcp is not installed")

LOGS = ["empty_1.csv", "loaded_1200g.csv"]
SWAPPED = """
robot: five-bar
signals: {time: t, position: {left: qleft, right: qright}, current: {left: vright, right: vleft}}
runs: [{log: empty_1.csv}, {log: loaded_1200g.csv, payload: {name: disc, mass: 1.2}}]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_tutorial(tmp_path / "project")
    return tmp_path / "project"


def client(folder: Path) -> Any:
    command = mcp.StdioServerParameters(
        command=sys.executable,
        args=["-m", "gtau", "mcp", str(folder)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    return mcp.Client(mcp.stdio_client(command), mode="legacy")  # which all clients speak


def call(folder: Path, *calls: tuple[str, dict[str, Any]]) -> list[Any]:
    async def talk() -> list[Any]:
        async with client(folder) as agent:
            return [await agent.call_tool(name, arguments) for name, arguments in calls]

    return asyncio.run(talk())


def text(answer: Any) -> str:
    return "\n".join(part.text for part in answer.content)


def told(answer: Any) -> dict[str, Any]:
    assert not answer.is_error, text(answer)
    return answer.structured_content


def files(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def test_an_agent_identifies_and_exports(folder: Path) -> None:
    (folder / "polars.py").write_text("raise SystemExit(9)")  # not imported from there
    before = files(folder.parent)
    stages = []

    async def talk() -> list[Any]:
        async def progress(done: float, total: float | None, message: str | None) -> None:
            stages.append(message)

        async with client(folder) as agent:
            logs = {"sources": LOGS, "robot": "five-bar"}
            identified = await agent.call_tool("identify", logs, progress_callback=progress)
            exported = await agent.call_tool("export", {"model": "result/model.json", "to": "csv", "out": "tables"})
            return [identified, exported]

    identified, exported = map(told, asyncio.run(talk()))
    gains = {gain["joint"]: gain for gain in identified["document"]["drive_gains"]}
    assert all(gains[joint]["outcome"] == "good" for joint in ("left", "right"))
    assert gains["left"]["value"] == pytest.approx(2.607, rel=0.01)
    assert "Both drive gains are known" in identified["summary"]
    assert "Next: predict a log that was not used" in identified["summary"]
    assert "covariance" in identified["left_out"]
    assert identified["exit_code"] == 0
    assert "<html" in (folder / identified["report"]).read_text(encoding="utf-8")
    assert all((folder / file).is_file() for file in exported["document"]["files"])
    assert {"base parameters", "estimation"} & set(stages)  # lines of progress come every 0.4 s
    assert all(path.is_relative_to(folder) for path in files(folder.parent) - before)


def test_the_answer_to_a_wrong_experiment_names_the_next_step(folder: Path) -> None:
    (folder / "swapped.yaml").write_text(SWAPPED)

    async def talk() -> None:
        async with client(folder) as agent:
            answer = await agent.call_tool("identify", {"sources": ["swapped.yaml"], "out": "swapped"})
            assert told(answer)["exit_code"] == 3
            finding = told(answer)["document"]["drive_gains"][0]["finding"]
            assert finding["advice"].startswith("check that the position and current columns are of the same joint")
            assert finding["advice"] in " ".join(answer.content[0].text.split())
            explained = told(await agent.call_tool("explain", {"finding": finding["kind"]}))
            [row] = explained["document"]["findings"]
            assert (row["name"], row["grade"]) == (finding["kind"], "contradictory")
            assert row["what to do"].startswith("check that the position")

    asyncio.run(talk())


def test_what_leads_out_of_the_folder_is_refused(folder: Path) -> None:
    outside = folder.parent / "outside"
    outside.mkdir()
    (outside / "log.csv").write_bytes((folder / "empty_1.csv").read_bytes())
    (folder / "link.csv").symlink_to(outside / "log.csv")
    (folder / "circle").symlink_to("circle")
    (folder / "out").mkdir()
    (folder / "out" / "sub").symlink_to(outside)
    logs, before = {"sources": ["empty_1.csv"], "robot": "five-bar"}, files(folder.parent)
    wrong = [
        ("check", logs | {"sources": ["../outside/log.csv"]}, "../outside/log.csv"),
        ("check", logs | {"sources": [str(outside / "log.csv")]}, str(outside / "log.csv")),
        ("check", logs | {"sources": ["link.csv"]}, "link.csv"),
        ("check", logs | {"sources": ["circle"]}, "circle"),
        ("check", logs | {"robot": "../outside/arm.urdf"}, "../outside/arm.urdf"),
        ("check", logs | {"out": "../outside"}, "../outside"),
        ("check", logs | {"out": "out"}, "out/sub"),
        ("robot", {"source": "five-bar", "save": "../outside/robot.yaml"}, "../outside/robot.yaml"),
        ("validate", {"model": "../model.json", "sources": ["experiment.yaml"]}, "../model.json"),
        ("export", {"model": "model.json", "to": "urdf", "out": "new", "into": "/etc/passwd"}, "/etc/passwd"),
        ("design_motion", {"design": "../design.yaml", "out": "new"}, "../design.yaml"),
    ]
    answers = call(folder, *((name, arguments) for name, arguments, _ in wrong))
    for answer, (_, _, path) in zip(answers, wrong, strict=True):
        assert answer.is_error
        assert text(answer) == f"{path} is outside of the project's folder; give a file in it."
    assert files(folder.parent) == before


def test_refusals_are_sentences(folder: Path) -> None:
    no_names, misspelt, missing, kind, unknown, finding, options = call(
        folder,
        ("check", {"sources": ["empty_1.csv"]}),
        ("check", {"source": "empty_1.csv"}),
        ("check", {}),
        ("check", {"sources": ["empty_1.csv"], "kind": "amperes"}),
        ("nonsense", {}),
        ("explain", {"finding": "the currents of 'a' and 'b' look swapped: 1 % is unexplained after it"}),
        ("check", {"sources": ["--out=x.csv"], "robot": "five-bar"}),
    )
    assert all(answer.is_error for answer in (no_names, misspelt, missing, kind, unknown, finding, options))
    assert text(no_names).startswith("empty_1.csv: no columns of positions are recognised among t, qleft")
    assert text(misspelt).startswith("check has no parameter 'source'; it has sources, robot, payload")
    assert text(missing) == "parameter 'sources' of check: field required."
    assert text(kind) == "parameter 'kind' of check: input should be 'current' or 'torque'."
    assert text(unknown) == "Unknown tool: nonsense"
    assert text(finding).endswith("did you mean 'swapped channels'?")
    assert "--out=x.csv" in text(options)
    assert not (folder / "x.csv").exists()


def test_a_cancelled_call_ends_its_command(folder: Path) -> None:
    anyio = pytest.importorskip("anyio")

    def is_held() -> bool:
        try:
            hold_folder(folder / "result")()
        except GtauError:
            return True
        return False

    async def talk() -> None:
        async with client(folder) as agent:
            with anyio.move_on_after(20) as cancelled:
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(agent.call_tool("identify", {"sources": LOGS, "robot": "five-bar"}))
                    while not (folder / "result" / "experiment.yaml").exists():
                        await asyncio.sleep(0.05)
                    assert is_held()
                    cancelled.cancel()
            deadline = time.monotonic() + 10
            while is_held() and time.monotonic() < deadline:
                await asyncio.sleep(0.05)
            assert not is_held()
            assert not told(await agent.call_tool("explain", {"finding": "frozen encoder"}))["exit_code"]

    asyncio.run(talk())
    assert not (folder / "result" / "model.json").exists()


def test_tools_and_resources_are_described(folder: Path) -> None:
    async def talk() -> tuple[Any, Any, Any]:
        async with client(folder) as agent:
            page = await agent.read_resource("gtau://docs/identify")
            assert agent.server_info.version == gtau.__version__
            return (await agent.list_tools()).tools, (await agent.list_resources()).resources, page.contents

    tools, resources, [page] = asyncio.run(talk())
    known = {"weigh": "payload", "design_motion": "excite"}
    group = typer.main.get_command(app)
    assert {tool.name for tool in tools} == {
        "check", "identify", "explain", "weigh", "validate", "design_motion", "export", "robot",
    }  # fmt: skip
    for tool in tools:
        assert tool.description
        assert all(parameter["description"] for parameter in tool.input_schema["properties"].values())
        if tool.name != "explain":
            command = group.get_command(typer.Context(group), known.get(tool.name, tool.name))
            words = {word for parameter in command.params for word in (parameter.name, *parameter.opts)}
            flags = {f"--{name.replace('_', '-')}" for name in tool.input_schema["properties"]}
            assert all(flag in words or flag[2:] in words for flag in flags)
    assert {str(resource.uri) for resource in resources} == {f"gtau://docs/{name}" for name in pages()}
    assert page.text == pages()["identify"].read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "name", "group"),
    [
        ("Frozen encoder", "frozen encoder", "contradictory"),
        ("the 95 % interval includes zero", "sign open", "not identifiable"),
        ("the 95 % interval is +-5.3 %, limited by the uncertainty of the scale reference", "uncertain scale", "weak"),
        ("skipped lines", "skipped lines", "information"),
        ("encoder zeros", "encoder zeros", "cause"),
    ],
)
def test_a_finding_is_explained_by_name_or_text(text: str, name: str, group: str) -> None:
    [row] = explain(text)
    assert (row["name"], row["grade"]) == (name, group)
    assert row["what to do"] or group == "information"


def test_a_missing_folder_or_package_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = CliRunner().invoke(app, ["mcp", str(tmp_path / "none")])
    assert done.exit_code == 2
    assert "none is not a folder; make it, or give another one." in done.output
    monkeypatch.delitem(sys.modules, "gtau.doors.mcp", raising=False)
    monkeypatch.setitem(sys.modules, "mcp.server.mcpserver", None)
    done = CliRunner().invoke(app, ["mcp", str(tmp_path)])
    assert done.exit_code == 2
    assert "pip install 'gtau[mcp]'" in done.output
