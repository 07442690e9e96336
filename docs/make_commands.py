"""Write ``lookup/commands.md``: every command with its arguments and options, as ``gtau COMMAND --help`` has them."""

from __future__ import annotations

import re
from pathlib import Path

import typer
from click import Context

from gtau.cli.commands import app, examples

PAGE = Path(__file__).parent / "lookup" / "commands.md"
HEAD = """# Commands

The help that `gtau COMMAND --help` prints (`python docs/make_commands.py` makes this page). With `--json` a command
prints one JSON document instead of tables.
"""


def prose(text: str) -> str:
    """Write help as Markdown: its paragraphs, what is typed in quotes as code."""
    text = re.sub(r"'(gtau [^']+)'|'?(?<!\w)(--[a-z-]+)'?", r"`\1\2`", text.replace("\b", ""))
    text = re.sub(r"docs/lookup/(\w+\.md)|docs/(\w+/\w+\.md)", lambda at: f"[{at[0]}]({at[1] or '../' + at[2]})", text)
    return re.sub(r"(?<!`)<(?=\w)", r"\\<", text).replace("+-", "±")


def rows(records: list[tuple[str, str]]) -> str:
    """Return a table of arguments and options."""
    lines = ["| | meaning |", "| --- | --- |"]
    for names, meaning in records:
        cells = (f"`{names.replace('|', chr(92) + '|')}`", prose(" ".join(meaning.split())).replace("|", "\\|"))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n\n"


def page() -> str:
    """Return the page."""
    group = typer.main.get_command(app)
    context = Context(group, info_name="gtau")
    names, sections = [], ""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        inner = Context(command, info_name=name, parent=context)
        command.get_help(inner)  # which leaves the Python types of arguments out
        given = (parameter.get_help_record(inner) for parameter in command.get_params(inner))
        records = [record for record in given if record and record[0] not in ("--help", "--json")]
        usage = " ".join(["gtau", name, *command.collect_usage_pieces(inner)])
        names.append(f"[{name}](#{name})")
        sections += f"\n## {name}\n\n```text\n{usage}\n```\n\n{prose(command.help.strip())}\n\n"
        sections += rows(sorted(records, key=lambda record: record[0].startswith("-")))
        sections += "```sh\n" + "\n".join(examples(name)) + "\n```\n"
    return (f"{HEAD}\n{', '.join(names)}\n" + sections).rstrip("\n").replace("\n\n\n", "\n\n") + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
