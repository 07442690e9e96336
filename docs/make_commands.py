"""Write ``lookup/commands.md``: every command with its arguments and options, as ``gtau COMMAND --help`` has them.

Options that several commands have for logs, and arguments, are listed once; of the examples the fullest is shown.
"""

from __future__ import annotations

import re
from pathlib import Path

import typer
from click import Context

from gtau.cli.commands import app, examples
from gtau.cli.logs import LogOptions

PAGE = Path(__file__).parent / "lookup" / "commands.md"
HEAD = """# Commands

As `gtau COMMAND --help` prints them. `--json` prints one JSON document.

## Logs in place of an experiment file

With logs {commands} and {last} take

"""
OF_LOGS = re.compile("--({})\\b".format("|".join(name.replace("_", "-") for name in LogOptions.__annotations__)))


def prose(text: str) -> str:
    """Write help as Markdown: its paragraphs, what is typed in quotes as code."""
    text = re.sub(r"'(gtau [^']+)'|'?(?<!\w)(--[a-z-]+)'?", r"`\1\2`", text.replace("\b", ""))
    text = re.sub(r"docs/lookup/(\w+\.md)|docs/(\w+/\w+\.md)", lambda at: f"[{at[0]}]({at[1] or '../' + at[2]})", text)
    return re.sub(r"(?<!`)<(?=\w)", r"\\<", text).replace("+-", "±")


def rows(records: list[tuple[str, str]]) -> str:
    """Return a list of arguments and options."""
    lines = []
    for names, meaning in records:
        said = prose(" ".join(meaning.removesuffix("[required]").split()))
        _, of_logs, said_of_logs = said.partition("With logs: ")
        lines.append(f"- `{names}`: {said_of_logs[0].upper() + said_of_logs[1:] if of_logs else said}\n")
    return "".join(lines)


def page() -> str:
    """Return the page."""
    group = typer.main.get_command(app)
    context = Context(group, info_name="gtau")
    sections, of_logs, told, with_logs = "", "", [], []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        inner = Context(command, info_name=name, parent=context)
        command.get_help(inner)  # which leaves the Python types of arguments out
        given = (parameter.get_help_record(inner) for parameter in command.get_params(inner))
        records = [record for record in given if record and record[0] not in ("--help", "--json")]
        sections += f"\n## {name}\n\n    {max(examples(name), key=len)}\n\n{prose(command.help.strip())}\n\n"
        stated = [record for record in records if OF_LOGS.match(record[0])]
        if len(stated) == len(LogOptions.__annotations__):
            of_logs = of_logs or rows(stated)
            with_logs.append(f"`{name}`")
            records = [record for record in records if record not in stated]
        arguments = [record for record in records if not record[0].startswith("-")]
        sections += rows([record for record in arguments if record not in told])
        sections += rows([record for record in records if record not in arguments])
        told += arguments
    head = HEAD.format(commands=", ".join(with_logs[:-1]), last=with_logs[-1])
    return (head + of_logs + sections).rstrip("\n").replace("\n\n\n", "\n\n") + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
