"""The reference of the command line, as Markdown: every command with its arguments and options, as --help has them."""

from __future__ import annotations

import click
import typer.main

from odescope.commands.cli import app


def command_reference() -> str:
    """Return one section a command."""
    group = typer.main.get_command(app)
    context = click.Context(group, info_name="odescope")
    return "\n\n".join(
        _section(group.get_command(context, name), context)  # type: ignore[attr-defined]
        for name in group.list_commands(context)  # type: ignore[attr-defined]
    )


def _section(command: click.Command, parent: click.Context) -> str:
    context = click.Context(command, info_name=command.name, parent=parent)
    entries = [_entry(p, context) for p in command.get_params(context) if p.name != "help"]
    usage = f"```sh\n{command.get_usage(context).removeprefix('Usage: ')}\n```"
    return "\n\n".join([f"## odescope {command.name}", usage, command.help or "", *entries])


def _entry(parameter: click.Parameter, context: click.Context) -> str:
    named, said = parameter.get_help_record(context) or ("", "")
    return f"`{named}`\n: {said.replace('  [', ' [')}"
