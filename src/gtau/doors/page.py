"""The page of a project: robot, logs, identification, and what follows, each in a card."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Set
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import events, ui

from gtau.doors.command import Answer, Command, within
from gtau.doors.project import BY_JOINT, COMMANDS, Project, RunEntry, settings_in
from gtau.doors.widgets import along, at_home, draw_in, drawing_of, refusal_of, refused, report, trace
from gtau.errors import GtauError
from gtau.extensions import names
from gtau.robots.readers.read import catalog_names
from gtau.signals.reading.discovery import QUESTIONS

MODEL = "result/model.json"
LARGEST = 4 << 30  # bytes of a file
REJECTED = "The file is larger than 4 GiB; copy it into the project's folder, and reload the page."
COLOURS = {"error": "negative", "warning": "warning", "information": "info"}
STYLE = """
.card { width: 100%; max-width: 72rem; margin: 0 auto }
iframe.report { width: 100%; height: 80vh; border: 1px solid #8884 } .soft { opacity: 0.75 }
.body--dark .text-negative { --q-negative: #ff8a80 }
@media (max-width: 600px) { .nicegui-content { padding: 0.5rem } }
"""


class Cards:
    """The page of one browser; all of them show the same project."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self.stage: ui.label
        self.seen: object = None
        self.opened = set[str]()  # logs whose columns are shown
        self.section = ""  # the one that is being drawn
        self.refusals: dict[str, str] = {}  # by section
        self.uploading = False  # then the page is not drawn again, which would end it
        self.sections = [ui.refreshable(section) for section in (self.robot, self.logs, self.identify, self.then)]

    def changed(self) -> None:
        """Draw the page again where the project has changed since."""
        running = self.project.running
        self.stage.set_text(running.stage if running else "")
        version = self.project.version
        if version != self.seen and not self.uploading:
            if self.seen is not None:  # a refusal ends with what was refused
                self.refusals.clear()
            self.seen = version
            for section in self.sections:
                section.refresh()

    @contextmanager
    def card(self, title: str) -> Iterator[None]:
        """Draw a card with a heading, and what was refused in it."""
        self.section = title
        with ui.card().classes("card"):
            ui.html(f"<h2 class='text-h6'>{title}</h2>", sanitize=False)
            try:
                yield
            except GtauError as error:
                refused(str(error))
            if title in self.refusals:
                refused(self.refusals[title])

    @contextmanager
    def trying(self, section: str) -> Iterator[None]:
        """Do what a user asks in a section, and show there with which sentence it is refused."""
        self.refusals.pop(section, None)
        try:
            yield
        except GtauError as error:
            self.refusals[section] = str(error)
            self.seen = None
        self.changed()

    async def command(self, *arguments: str) -> None:
        """Run a command, one at a time in a project; its answer stays with the project."""
        project = self.project
        if project.running is not None:
            ui.notify(f"{project.running.arguments[0]} runs; wait for its end, or cancel it.", type="warning")
            return
        project.running = Command(arguments, project.folder)
        try:
            project.answers[arguments[0]] = await project.running.run()
        finally:
            project.running = None

    def button(self, label: str, work: Callable[[], Awaitable[Any] | None], **more: Any) -> ui.button:
        """Add a button whose refusals are shown."""
        section = self.section

        async def clicked() -> None:
            with self.trying(section):
                if (made := work()) is not None:
                    await made

        return ui.button(label, on_click=clicked, **more).props("no-caps outline")

    def upload(self, label: str, then: Callable[[str], Any], place: str = "") -> None:
        """Add a place for files, which are written to the project's folder, or a ``place`` in it."""
        section = self.section

        async def received(event: events.MultiUploadEventArguments) -> None:
            self.uploading = False
            with self.trying(section):
                for file in event.files:
                    path = within(self.project.folder, f"{place}/{file.name}".lstrip("/"))
                    if path.exists():
                        raise GtauError(f"{path.name} is in the folder already; rename one of the two.")
                    unfinished = path.with_name(f".{path.name}.part")
                    await file.save(unfinished)
                    unfinished.replace(path)
                    then(path.name)

        def rejected() -> None:
            self.uploading = False
            with self.trying(section):
                raise GtauError(REJECTED)

        box = ui.upload(label=label, multiple=True, auto_upload=True, max_file_size=LARGEST).classes("w-full")
        box.props("flat bordered batch")
        box.on_begin_upload(lambda: setattr(self, "uploading", True))
        box.on_multi_upload(received)
        box.on_rejected(rejected)

    def robot(self) -> None:
        """Choose a robot, and look at it."""
        with self.card("1  Robot"):
            robot = self.project.robot() or self.project.chosen
            with ui.row().classes("items-end w-full"):
                catalog = {name: name for name in catalog_names()}
                files = {name: name for name in self.project.robot_files()}
                options = files | catalog | ({robot: robot} if robot else {})
                choice = ui.select(options, label="Robot", value=robot, with_input=True).classes("w-64")
                choice.on_value_change(partial(self.edit, self.project.choose))
            self.upload("Drop a robot file: URDF, xacro, MJCF, robot file", self.project.choose)
            if robot is not None:
                loaded = self.project.loaded(robot)
                drawing_of(at_home(loaded))
                driven = ", ".join(loaded.actuated)
                ui.label(f"{loaded.name}: {len(loaded.actuated)} driven joints ({driven})").classes("soft")
                for note in loaded.file.notes:
                    ui.label(note).classes("soft")

    def logs(self) -> None:
        """Show the logs with the roles of their columns, payloads and findings."""
        project = self.project
        with self.card("2  Logs"):
            self.upload("Drop logs: CSV, Parquet, MAT, HDF5, TDMS, bag, ...", lambda name: None)
            waiting = project.logs_in_folder()
            if waiting and not project.text:
                ui.label(f"Logs: {', '.join(waiting)}")
                self.button("Draft the experiment from these logs", lambda: self.draft(waiting))
            for log in waiting if project.text else ():
                with ui.row().classes("items-center"):
                    ui.label(log)
                    self.button("Use it", partial(project.add_run, log))
                    self.button("Weigh its load", partial(self.weigh, log))
            if (drafted := project.answers.get("init")) is not None and drafted.refusal:
                refused(drafted.refusal + " Or choose the roles of the columns below." * bool(project.text))
                logs = {*(run.log for run in project.runs()), *waiting} - project.left_out
                for log in sorted(logs) if project.text == project.skeleton else ():
                    if log in drafted.refusal and (rest := sorted(logs - {log})):
                        self.button(f"Draft without {log}", partial(self.draft, rest, project.left_out | {log}))
            if not project.text:
                return
            findings = self.findings("check")
            for point in project.points():
                with ui.row().classes("items-center no-wrap"):
                    ui.icon("help_outline")
                    ui.label(f"To confirm: {point}")
                    with ui.column().classes("shrink-0 gap-1"):
                        self.button("It is right", partial(project.confirm, point))
                        if point.endswith(QUESTIONS["kind"]):
                            other = "torques" if "current" in project.content["signals"] else "currents"
                            self.button(f"They are {other}", partial(project.exchange, point))
            with ui.row().classes("items-end"):
                for key in ("position", *COMMANDS):
                    if project.content.get("signals", {}).get(key):
                        field = ui.input(f"Unit of {key}", value=project.unit(key), placeholder="SI").classes("w-40")
                        field.on("change", partial(self.edit, partial(project.set_unit, key), field))
            for entry in project.runs():
                self.log(entry, [finding for finding in findings if about(finding, entry)])
            others = [finding for finding in findings if not any(about(finding, entry) for entry in project.runs())]
            self.show_findings(others)
            self.button("Check the logs", lambda: self.command("check", project.file.name, "--out", "check"))
            refusal_of(checked := project.answers.get("check"))
            if checked is not None and not (checked.refusal or findings):
                ui.label("The logs were checked, without findings.").classes("text-positive")

    def edit(self, change: Callable[[Any], None], field: Any, *event: Any) -> None:
        """Write the value of a field to the experiment file."""
        with self.trying("2  Logs"):
            change(field.value)

    async def draft(self, logs: list[str], left_out: Set[str] = frozenset()) -> None:
        """Draft the experiment file, some logs ``left_out``; where columns are not recognised, it lacks them."""
        project = self.project
        if not project.chosen:
            raise GtauError("no robot is chosen; choose it above first.")
        if project.text and project.text == project.skeleton:  # of a refused draft, as it was written
            project.file.unlink()
        await self.command("init", *logs, "--robot", project.chosen)
        project.skeleton, project.left_out = project.text, left_out

    def log(self, entry: RunEntry, findings: list[dict[str, Any]]) -> None:
        """Show a log: its payload, use, findings, and columns."""
        project = self.project
        with ui.column().classes("w-full gap-1"):
            with ui.row().classes("items-end"):
                ui.label(entry.log).classes("text-bold")
                mass = ui.number("Payload, kg", value=entry.mass or 0, min=0, step=0.1).classes("w-32")
                mass.on("change", partial(self.edit, partial(project.set_mass, entry.log), mass))
                box = ui.checkbox("for validation", value=entry.validation)
                box.on_value_change(partial(self.edit, partial(project.set_validation, entry.log)))
                self.button("Remove", partial(project.remove_run, entry.log))
            self.show_findings(findings)
            shown = ui.expansion("Columns", icon="show_chart", value=entry.log in self.opened).classes("w-full")
            show = partial(self.columns, entry.log, shown)
            shown.on_value_change(show)
            if entry.log in self.opened:
                ui.timer(0.0, show, once=True)

    async def columns(self, log: str, place: ui.expansion) -> None:
        """Draw each column beside its role."""
        if not place.value:
            self.opened.discard(log)
            return
        self.opened.add(log)
        place.clear()
        with place:
            try:
                traces = await asyncio.to_thread(self.project.traces, log)
            except GtauError as error:
                return refused(str(error))
            robot, roles = self.project.robot(), self.project.roles()
            joints = list(self.project.loaded(robot).actuated) if robot else []
            options = ["", "time", *(f"{key} {joint}" for key in BY_JOINT for joint in joints)]
            for column, values in sorted(traces.items(), key=lambda item: item[0] not in roles):
                with ui.row().classes("items-center w-full"):
                    role = roles.get(column, "")
                    chosen = options if role in options else [*options, role]
                    field = ui.select(chosen, label=column, value=role, with_input=True).classes("w-56")
                    field.on_value_change(partial(self.edit, partial(self.project.set_role, column)))
                    trace(values.tolist())

    def findings(self, name: str) -> list[dict[str, Any]]:
        """List the findings of a command's last answer."""
        answer = self.project.answers.get(name)
        return [] if answer is None or answer.refusal or not answer.document else answer.document.get("findings", [])

    def show_findings(self, findings: list[dict[str, Any]]) -> None:
        """Show findings, each with a button where its advice is a setting."""
        for finding in findings:
            with ui.row().classes("items-center w-full"):
                ui.badge(finding["grade"], color=COLOURS.get(finding["grade"], "grey"))
                ui.label(finding["what"]).classes("grow")
                for setting in settings_in(finding["action"] or ""):
                    self.button(f"Set {setting}", partial(self.project.apply, setting))

    def identify(self) -> None:
        """Identify, and show the report."""
        project = self.project
        with self.card("3  Identify"):
            if not project.text:
                ui.label("First choose a robot and drop logs.").classes("soft")
                return
            consistent = ui.checkbox("also find physically consistent parameters, which simulators need")
            arguments = ("identify", project.file.name, "--out=result")
            self.button("Identify", lambda: self.command(*arguments, *["--consistent"] * consistent.value))
            refusal_of(project.answers.get("identify"))
            report(project.folder, "result")

    def then(self) -> None:
        """Weigh, validate, export, and design the next motion."""
        project = self.project
        with self.card("4  Then"):
            if not (project.folder / "result" / "model.json").exists():
                ui.label("After an identification: weigh, validate, export, or design the next motion.").classes("soft")
                return
            with ui.row().classes("items-end"):
                log = ui.select(project.logs_in_folder(), label="Log of an unknown load").classes("w-56")
                self.button("Weigh it", lambda: self.weigh(log.value))
                self.button("Validate", lambda: self.command("validate", MODEL, project.file.name, "--out", "validate"))
            with ui.row().classes("items-end"):
                kind = ui.select(names("gtau.exports", "gtau.export"), label="Export", value="c").classes("w-56")
                self.button("Export", lambda: self.command("export", MODEL, "--to", kind.value, "--out=export"))
            with ui.row().classes("items-end"):
                mass = ui.number("Payload of the next motion, kg", value=1.0, min=0.01).classes("w-56")
                self.button("Design the next motion", lambda: self.campaign(mass.value))
            for name in ("payload", "validate", "export", "campaign"):
                if (answer := project.answers.get(name)) is not None:
                    self.answered(name, answer)

    async def weigh(self, log: str | None) -> None:
        """Weigh the load of a log."""
        if not log:
            raise GtauError("no log is chosen; drop the log of the load above, then choose it here.")
        empty = [entry.log for entry in self.project.runs() if entry.mass == 0][:1]
        await self.command("payload", MODEL, log, *empty, *(f"--payload={other}=0" for other in empty), "--out=payload")

    async def campaign(self, mass: float) -> None:
        """Take the next round of a campaign."""
        new = [] if (self.project.folder / "campaign" / "design.yaml").exists() else ["--payload-mass", f"{mass:g}"]
        robot = ["--robot", str(self.project.robot())] if new else []
        await self.command("campaign", "campaign", *robot, *new)

    def answered(self, name: str, answer: Answer) -> None:
        """Show the answer of a command."""
        project = self.project
        ui.label(name).classes("text-bold")
        refusal_of(answer)
        if answer.refusal:
            return
        for payload in answer.document["payloads"] if name == "payload" else ():
            mass, (low, high) = payload["parameters"]["m"]["value"], payload["parameters"]["m"]["interval"]
            words = f"{mass:.4g} kg ± {(high - low) / 2:.2g} kg ({payload['outcome']})"
            ui.label(f"{payload['name']}: {words}").classes("text-h6")
        if name == "export":
            for file in answer.document["files"]:
                ui.link(file, f"/files/{file}", new_tab=True)
            for note in answer.document["notes"]:
                ui.label(note).classes("soft")
        elif name == "campaign":
            ui.label(answer.document["say"])
            for motion in sorted((project.folder / "campaign").glob("*/motion.csv"))[-1:]:
                place = motion.relative_to(project.folder)
                ui.link(str(place), f"/files/{place}", new_tab=True)
                self.button("Show the motion", partial(self.animate, motion))
                self.upload("Drop the logs of this motion, played", lambda name: None, str(place.parent))
        report(project.folder, name)

    async def animate(self, motion: Path) -> None:
        """Show a motion before it is played."""
        frames = await asyncio.to_thread(along, self.project.loaded(str(self.project.robot())), motion)
        with ui.dialog() as dialog, ui.card():
            scene, at, shown = drawing_of(frames[0]), [0], []
            for frame in frames[1:]:
                with scene, scene.group() as group:
                    draw_in(scene, frame)
                shown.append(group.visible(False))

            def step() -> None:
                shown[at[0]].visible(False)
                at[0] = (at[0] + 1) % len(shown)
                shown[at[0]].visible(True)

            clock = ui.timer(0.15, step)
            ui.button("Close", on_click=dialog.close).props("no-caps")
        dialog.on("hide", clock.cancel)
        dialog.open()


def draw(project: Project) -> None:
    """Draw the page of a project."""
    view = Cards(project)
    ui.add_css(STYLE)
    with ui.header().classes("items-center"):
        ui.label(f"gtau  {project.folder.name}").classes("text-h6")
        ui.space()
        view.stage = ui.label("").props("aria-live=polite")
        cancel = ui.button("Cancel", on_click=project.cancel, color="white")
        cancel.props("no-caps outline").bind_visibility_from(project, "running", backward=bool)
        ui.spinner(color="white").bind_visibility_from(project, "running", backward=bool)
    for section in view.sections:
        section()
    view.seen = project.version
    ui.timer(0.5, view.changed)


def about(finding: dict[str, Any], entry: RunEntry) -> bool:
    """Decide whether a finding is about a log."""
    return bool(finding["source"]) and finding["source"] in entry.log
