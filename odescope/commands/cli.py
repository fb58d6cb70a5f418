"""The command line: arguments to calls, errors to exit codes (0 done, 2 wrong input, 3 no model, 130 stopped)."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from odescope.commands.options import (
    BasisOption,
    ClusterOption,
    DataFiles,
    DegreeOption,
    DelayOption,
    EventsFile,
    GapsOption,
    ModelFile,
    Recording,
    SamplePeriod,
    Seconds,
    Sources,
    StatesFile,
    Time,
    TimeUnitOption,
)
from odescope.errors import OdescopeError, Stopped
from odescope.export.exported import export_names

if TYPE_CHECKING:
    from odescope.commands.run import RunResult

EXPORTS = export_names()

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # drawing frames around the help costs a third of its time
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Read sparse, possibly rational, ordinary differential equations off noisy recorded measurements.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from odescope import __version__

        print(f"odescope {__version__}")
        raise typer.Exit


def entry() -> None:
    """Run `main` as a program, and exit without taking down modules one by one, which costs half a second."""
    code: int | str | None = 0
    try:
        main()
    except SystemExit as end:
        code = end.code
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        pass
    except OSError as error:
        print(f"odescope: {error.strerror or error}", file=sys.stderr)
        code = 2
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None: ...


def main() -> None:
    """Run the command line; wrong input ends with one message on standard error."""
    try:
        app()
    except OdescopeError as error:
        print(f"odescope: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:  # whatever no message of its own foresees
        where = f": {error.filename}" if error.filename else ""
        print(f"odescope: {error.strerror or error}{where}", file=sys.stderr)
        sys.exit(2)
    except SystemExit as end:
        if end.code == Stopped.exit_code:  # typer has turned the interrupt into this
            print("odescope: stopped before any result was written", file=sys.stderr)
        raise


@app.command(short_help="Identify the equations behind a recording.")
def identify(
    sources: Sources,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for the results.", show_default="the source's name, beside it"),
    ] = None,
    time: Annotated[
        str | None, typer.Option(help="Column that holds the time, in seconds or as its heading says.")
    ] = None,
    time_unit: TimeUnitOption = None,
    sample_period: SamplePeriod = None,
    coordinate: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[:cyclic][:angle][:order=N]", help="A measured column; repeat for more."),
    ] = None,
    input_: Annotated[
        list[str] | None, typer.Option("--input", metavar="NAME[:zero]", help="A recorded input; repeat for more.")
    ] = None,
    order: Annotated[
        int | None, typer.Option(help="Order of the equations of all coordinates.", show_default="1")
    ] = None,
    recording: Recording = None,
    gaps: GapsOption = None,
    delay: DelayOption = None,
    basis: BasisOption = None,
    degree: DegreeOption = None,
    cluster: ClusterOption = None,
    seconds: Seconds = None,
    events: EventsFile = None,
) -> None:
    """Identify the equations behind a recording: writes model.json, report.html and more to a folder."""
    from odescope.commands.arguments import DataArguments, resolve, results_folder, with_seconds
    from odescope.commands.event_file import told_to
    from odescope.commands.run import run_study
    from odescope.commands.terminal import shown
    from odescope.events import Monitor

    columns, delays, functions = (tuple(coordinate or ()), tuple(input_ or ())), tuple(delay or ()), tuple(basis or ())
    given = DataArguments(time, sample_period, *columns, order, recording, gaps, delays, functions, degree, time_unit)
    with told_to(events) as tell_file:
        study, folder = resolve(sources, given)
        study = study if seconds is None else with_seconds(study, seconds)
        place = results_folder(sources, study, folder)
        with shown(tell_file) as tell:
            run = run_study(
                study,
                folder,
                place if out is None else out,
                title=sources[0].stem if len(sources) == 1 else place.name,
                source=sources[0],
                monitor=Monitor(tell),
                cluster=cluster,
            )
    _say_trust(run)


@app.command(short_help="Write a study from a look at data.")
def init(
    sources: DataFiles,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The study.", show_default="the source's name with .toml, beside it"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a study that is there.")] = False,
) -> None:
    """Write a commented study from a look at data: columns, sampling, units, angles, what to leave out."""
    from odescope.commands.init import init_study

    path, drafted = init_study(sources, out, force)
    told = f"coordinates: {drafted.count('coordinate')}, inputs: {drafted.count('input')}"
    told += f"; left out, see its last lines: {', '.join(drafted.left_out)}" if drafted.left_out else ""
    print(f"wrote {path} ({told}): read it, then run odescope identify {path}", file=sys.stderr)


@app.command(short_help="Run a model under a recording's inputs.")
def simulate(
    model: ModelFile,
    data: Annotated[Path, typer.Argument(metavar="DATA", help="The recording whose inputs drive it.")],
    out: StatesFile = None,
    time: Time = None,
    sample_period: SamplePeriod = None,
    recording: Recording = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STATE=VALUE", help="A state at the first sample; repeat for more.", show_default="fitted"
        ),
    ] = None,
) -> None:
    """Run a model freely from the first sample of a recording, under its inputs."""
    from odescope.commands.files import refuse_overwriting
    from odescope.commands.free_run import free_runs
    from odescope.files import check_file

    if out is not None:
        check_file(out)
        refuse_overwriting([out], [model, data])
    made = free_runs(model, data, time, sample_period, recording, initial or [])
    for note in made.notes:
        print(f"note: {note}", file=sys.stderr)
    _deliver(made.text, made.lines, out)


@app.command("filter", short_help="Estimate the states of a machine from a log.")
def filter_(
    model: ModelFile,
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A recording of its coordinates and inputs.")],
    out: StatesFile = None,
    smooth: Annotated[bool, typer.Option("--smooth", help="Let every state rest on later samples, too.")] = False,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COORDINATE=NUMBER",
            help="Standard deviation of a sample, in the unit of its column; repeat for more.",
            show_default="as identified",
        ),
    ] = None,
    process_noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TARGET=NUMBER | fit",
            help="What the equations leave out, times the root of a second; repeat for more.",
            show_default="as the model's errors ask for",
        ),
    ] = None,
    time: Time = None,
    sample_period: SamplePeriod = None,
    recording: Recording = None,
) -> None:
    """Estimate the states of a machine, velocities included, with standard deviations: a Kalman filter or smoother."""
    from odescope.commands.files import refuse_overwriting
    from odescope.commands.observe import NoiseOptions, filtered
    from odescope.files import check_file
    from odescope.model.recorded import TimeColumns

    if out is not None:
        check_file(out)
        refuse_overwriting([out], [model, data])
    options = NoiseOptions(tuple(noise or ()), tuple(process_noise or ()))
    text, lines = filtered(model, data, TimeColumns(time, sample_period, recording), options, smooth)
    _deliver(text, lines, out)


@app.command(short_help="Judge models on data that they have not seen.")
def validate(
    files: Annotated[
        list[Path], typer.Argument(metavar="MODEL.json ... [DATA ...]", help="Models, and data that they are run on.")
    ],
    data: Annotated[list[Path] | None, typer.Option(help="Data; repeat for more.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for the table and a figure.", show_default="none is written"),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COORDINATE=NUMBER",
            help="Standard deviation of a sample in the unit of its column, for one-step predictions; repeat for more.",
            show_default="as identified",
        ),
    ] = None,
    time: Time = None,
    sample_period: SamplePeriod = None,
    recording: Recording = None,
) -> None:
    """Judge models on data that they have not seen: fits of free runs and of one-step predictions, valid times."""
    from odescope.commands.files import check_writable, refuse_overwriting
    from odescope.commands.terminal import say
    from odescope.commands.validation import FIGURE, TABLE, ValidationFiles, validated, validation_files
    from odescope.files import write_files
    from odescope.model.recorded import TimeColumns

    named = ValidationFiles.of(files, data or ())
    if out is not None:
        check_writable(out)
        targets = [out / name for name in (TABLE, f"{FIGURE}.svg", f"{FIGURE}.png")]
        refuse_overwriting(targets, [*named.models, *named.data])
    found, models = validated(named, TimeColumns(time, sample_period, recording), noise or ())
    if out is not None:
        write_files(out, validation_files(found, next(iter(models.values()))))
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    say("".join(f"{line}\n" for line in found.lines))


@app.command(short_help="Identify a simulated pendulum on a cart.")
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the log, the study and the results.")] = Path(
        "odescope-demo"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the input and the noise.")] = 0,
    level: Annotated[
        int, typer.Option(min=1, max=4, help="Noise: 1 as in the paper, each step up to ten times more.")
    ] = 1,
    friction: Annotated[float, typer.Option(min=0.0, help="Joint friction b1 in N m s.")] = 0.01,
) -> None:
    """Simulate the paper's pendulum on a cart, add noise, and identify it: prints Table 2 beside the truth."""
    from odescope.commands.demo import run_demo
    from odescope.commands.terminal import say, shown
    from odescope.events import Monitor
    from odescope.report.console import table_text

    with shown() as tell:
        run = run_demo(out, seed, level, friction, Monitor(tell))
    _say_trust(run)
    say(table_text(run.report))


@app.command(short_help="Open a page to identify and look at results.")
def workbench(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Logs, studies and results; nothing else is seen.")
    ] = Path(),
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on this machine.", show_default="the folder's, or a free one")
    ] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address, and open nothing.")] = False,
) -> None:
    """Open a local page on the logs, studies and results of a folder: look, identify, compare, export."""
    from odescope.commands.workbench import open_workbench

    open_workbench(folder, port, show=not no_browser)


@app.command(short_help="Draw a report again from stored results.")
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results of identify or demo.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for report.html and figures.", show_default="DIR itself")
    ] = None,
) -> None:
    """Draw report.html and its figures again from the stored results."""
    from odescope.commands.run import draw_again, results_at
    from odescope.commands.terminal import shown
    from odescope.events import Monitor

    with shown() as tell:
        place = results_at(folder)
        draw_again(place, place if out is None else out, Monitor(tell))


@app.command(short_help="Write a model as text, as code, or for a page or paper.")
def export(
    model: ModelFile,
    to: Annotated[str, typer.Option(metavar="|".join(EXPORTS), help="What to write.")] = "text",
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="File, or folder for several files.", show_default="standard output"),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="What a program is called.", show_default="as the file, else plant")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write to a folder that holds files.")] = False,
) -> None:
    """Write a model as text, as LaTeX or MathML for people, or as code that runs it: see docs/exports.md."""
    from odescope.commands.export import export_model

    export_model(model, to, out, name, force)


def _deliver(text: str, lines: Iterable[str], out: Path | None) -> None:
    """Write a table to a file, and what there is to say of it beside; without a file that is standard output's."""
    from odescope.commands.terminal import say
    from odescope.files import write_file

    if out is None:
        for line in lines:
            print(line, file=sys.stderr)
        say(text)
    else:
        write_file(out, text)
        say("".join(f"{line}\n" for line in lines))


def _say_trust(run: RunResult) -> None:
    """Say on standard error how far to trust what was found, coefficient by coefficient and as a whole."""
    from odescope.commands.terminal import errors_text
    from odescope.report.console import trust_text

    print(f"{errors_text(run.result.model)}\n{trust_text(run.report)}", end="", file=sys.stderr)


if __name__ == "__main__":
    main()
