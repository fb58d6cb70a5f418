"""The command line: arguments to a study, a study to files, errors to exit codes (DESIGN 3.1)."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from odescope.errors import InputError, OdescopeError
from odescope.export.languages import names, writer

if TYPE_CHECKING:
    from odescope.arrays import FloatArray
    from odescope.model.model import Model
    from odescope.pipeline.identification import Identification
    from odescope.report.data import Report, TableRow
    from odescope.study.options import Study

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # drawing frames around the help costs a third of its time
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Read sparse, possibly rational, ordinary differential equations off noisy recorded measurements.",
)


STOPPED = 130


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
        if end.code == STOPPED:  # typer has turned the interrupt into this
            print("odescope: stopped before any result was written", file=sys.stderr)
        raise


@app.command(short_help="Identify the equations behind a recording.")
def identify(
    source: Annotated[Path, typer.Argument(metavar="STUDY.toml | DATA", help="A study, or a data file with options.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="the source's name, beside it")
    ] = None,
    time: Annotated[str | None, typer.Option(help="Column that holds the time in seconds.")] = None,
    sample_period: Annotated[
        float | None, typer.Option(help="Sampling period in seconds, where no column has it.")
    ] = None,
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
    recording: Annotated[str | None, typer.Option(help="Column that splits a file into recordings.")] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="local | tcp://HOST:PORT", help="Run on Dask workers, which read the files where they lie."
        ),
    ] = None,
) -> None:
    """Identify the equations behind a recording: writes model.json, report.html and more to a folder."""
    from odescope.study.options import read_study

    options = (time, sample_period, coordinate, input_, order, recording)
    if source.suffix.lower() == ".toml":
        if any(o is not None for o in options):
            raise InputError("with a study file, data options belong in the study; only --out may stand beside it")
        study = read_study(source)
        folder = source.parent
    else:
        study = _study_of(source, time, sample_period, coordinate or [], input_ or [], order, recording)
        folder = Path()
    out = _results_folder(source) if out is None else out
    _identify_and_write(study, folder, out, source.stem, source, cluster=cluster)


@app.command(short_help="Run a model under a recording's inputs.")
def simulate(
    model: Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model written by identify.")],
    data: Annotated[Path, typer.Argument(metavar="DATA", help="The recording whose inputs drive it.")],
    out: Annotated[Path | None, typer.Option(help="CSV file for the states.", show_default="standard output")] = None,
    time: Annotated[
        str | None,
        typer.Option(help="Column that holds the time.", show_default="as identified, else t or time"),
    ] = None,
    sample_period: Annotated[
        float | None, typer.Option(help="Sampling period in seconds, where no column has it.")
    ] = None,
    recording: Annotated[str | None, typer.Option(help="Column that splits the file into recordings.")] = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STATE=VALUE", help="A state at the first sample; repeat for more.", show_default="fitted"
        ),
    ] = None,
) -> None:
    """Run a model freely from the first sample of a recording, under its inputs."""
    from odescope.commands.files import check_file, refuse_overwriting, write_file
    from odescope.commands.free_run import free_runs

    if out is not None:
        check_file(out)
        refuse_overwriting([out], [model, data])
    text, notes = free_runs(model, data, time, sample_period, recording, initial or [])
    for note in notes:
        print(f"odescope: {note}", file=sys.stderr)
    if out is None:
        _say(text)
    else:
        write_file(out, text)


@app.command(short_help="Identify a simulated pendulum on a cart.")
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the log, the study and the results.")] = Path("odescope-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the input and the noise.")] = 0,
    level: Annotated[
        int, typer.Option(min=1, max=4, help="Noise: 1 as in the paper, each step up to ten times more.")
    ] = 1,
    friction: Annotated[float, typer.Option(min=0.0, help="Joint friction b1 in N m s.")] = 0.01,
) -> None:
    """Simulate the paper's pendulum on a cart, add noise, and identify it: prints Table 2 beside the truth."""
    from odescope.commands.demo import cart_pendulum, simulate_log, table_two, true_signals, write_log
    from odescope.commands.files import check_writable
    from odescope.report.console import table_text
    from odescope.study.options import read_study

    check_writable(out)
    out.mkdir(parents=True, exist_ok=True)
    with _progress() as watch:
        watch("simulating the pendulum on a cart")
        log = simulate_log(seed, level, friction)
        study = write_log(out, log, seed)
    print(f"wrote {out / 'log.csv'} and {study}", file=sys.stderr)
    report = _identify_and_write(
        read_study(study),
        out,
        out,
        "Pendulum on a cart",
        study,
        truth=lambda: true_signals(log, friction),
        table=lambda found: table_two(cart_pendulum(friction), found),
    )
    _say(table_text(report))


@app.command(short_help="Draw a report again from stored results.")
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results of identify or demo.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html and figures.", show_default="DIR itself")
    ] = None,
) -> None:
    """Draw report.html and its figures again from the stored results."""
    from odescope.commands.files import check_writable, write_files
    from odescope.report.assemble import read_report
    from odescope.report.figures.paint import painters
    from odescope.report.figures.pictures import pictures
    from odescope.report.page import report_files

    stored = read_report(folder / "report.json")
    out = folder if out is None else out
    check_writable(out)
    with painters() as painter, _progress() as watch:
        watch("drawing the report")
        files = report_files(stored, painter.paint(pictures(stored)))
    write_files(out, {name: content for name, content in files.items() if name != "report.json"})
    print(f"wrote {out}/: report.html, figures/", file=sys.stderr)


@app.command(short_help="Write a model as text, LaTeX or Python.")
def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model written by identify.")],
    to: Annotated[str, typer.Option(metavar="|".join(names()), help="What to write.")] = "text",
    out: Annotated[Path | None, typer.Option(help="File to write.", show_default="standard output")] = None,
) -> None:
    """Write a model as text, as LaTeX, as MathML, or as a Python module that imports numpy alone."""
    from odescope.commands.files import refuse_overwriting, write_file
    from odescope.export.model_file import read_model

    write = writer(to)
    text = write(read_model(model)).rstrip("\n") + "\n"
    if out is None:
        _say(text)
    else:
        refuse_overwriting([out], [model])
        write_file(out, text)


def _study_of(
    source: Path,
    time: str | None,
    sample_period: float | None,
    coordinates: list[str],
    inputs: list[str],
    order: int | None,
    recording: str | None,
) -> Study:
    from odescope.recordings.readers import column_names
    from odescope.study.options import Data, Driven, Measured, Study

    if not coordinates:
        columns = ", ".join(column_names(source))
        raise InputError(
            f"name at least one measured column of {source.name}, --coordinate NAME, or pass a study (.toml) instead;"
            f" its columns are: {columns}"
        )
    if time is None and sample_period is None:
        raise InputError("name the column that holds the time, --time NAME, or give --sample-period SECONDS")
    measured, driven = {}, {}
    for text in coordinates:
        name, *flags = text.split(":")
        _check_plain("coordinate", name)
        given: dict[str, int | bool] = {"order": 1 if order is None else order}
        for flag in flags:
            if flag in ("cyclic", "angle"):
                given[flag] = True
            elif flag.startswith("order=") and flag[6:].isdecimal():
                given["order"] = int(flag[6:])
            else:
                raise InputError(f"--coordinate {text}: after the name come cyclic, angle or order=N; {flag!r} came")
        if name in measured:
            raise InputError(f"--coordinate {name} is given twice")
        measured[name] = Measured(
            order=int(given["order"]), cyclic=bool(given.get("cyclic")), angle=bool(given.get("angle"))
        )
    for text in inputs:
        name, *flags = text.split(":")
        _check_plain("input", name)
        if name in driven:
            raise InputError(f"--input {name} is given twice")
        if flags not in ([], ["zero"], ["linear"]):
            raise InputError(f"--input {text}: after the name comes zero or linear; {':'.join(flags)!r} came")
        driven[name] = Driven(hold="zero" if flags == ["zero"] else "linear")
    data = Data(files=(str(source),), time=time, sample_period=sample_period, recording=recording)
    study = Study(data=data, coordinates=measured, inputs=driven)
    study.measured()
    return study


def _check_plain(option: str, name: str) -> None:
    if not (name.isascii() and name.isidentifier()):
        raise InputError(
            f"--{option}: {name!r} is not a plain name; in a study file, a {option} with a plain name can read any"
            f" column, by column = {name!r}"
        )


def _results_folder(source: Path) -> Path:
    """Return the default folder: beside the source, called like it less its endings."""
    name = source.name
    stem = Path(name.removesuffix(".gz")).stem.lstrip(".")
    return source.parent / (stem if stem not in ("", name) else f"{stem}-results")


def _identify_and_write(
    study: Study,
    folder: Path,
    out: Path,
    title: str,
    source: Path,
    truth: Callable[[], dict[str, FloatArray]] = dict,
    table: Callable[[Model], Sequence[TableRow]] = lambda _: (),
    cluster: str | None = None,
) -> Report:
    import msgspec

    from odescope.commands.files import (
        FACTORS,
        RESULT_FILES,
        check_writable,
        refuse_overwriting,
        result_files,
        write_files,
    )
    from odescope.errors import Stopped
    from odescope.export.languages.text import to_text
    from odescope.pipeline.identification import identify as run
    from odescope.report.assemble import observed, summary
    from odescope.report.console import trust_text
    from odescope.report.figures.paint import painters
    from odescope.report.figures.pictures import early_pictures, pictures
    from odescope.report.page import report_files
    from odescope.report.searches import searched
    from odescope.study.options import moved, study_toml

    resolved = moved(study, folder, out)
    check_writable(out)
    rerun = source.suffix.lower() == ".toml" and source.read_text(encoding="utf-8") == study_toml(resolved)
    read = [folder / f for f in study.data.files] + ([] if rerun else [source])
    refuse_overwriting([out / name for name in RESULT_FILES], read)
    placed = msgspec.structs.replace(
        study, data=msgspec.structs.replace(study.data, files=tuple(str(folder / f) for f in study.data.files))
    )
    if study.likelihood.enabled and not _compiled():
        print("compiling the kernels, once: this takes about a minute", file=sys.stderr)
    known = []

    def begin(found: Identification) -> None:
        """Draw what the likelihood does not change while it runs."""
        known.append(observed(found, truth()))
        painter.begin(early_pictures(known[0], searched(found)))

    with painters() as painter:
        with _progress() as watch:
            kept = [""]

            def follow(stage: str) -> None:
                kept[0] = stage.split(",")[0].split(": ")[-1] if stage.startswith("recordings: ") else kept[0]
                watch(stage)

            try:
                result = run(placed, watch=follow, draft=begin, cluster=cluster, store=out / FACTORS)
            except KeyboardInterrupt:
                resume = f"; {kept[0]} are kept: the same command goes on from there" if kept[0] else ""
                raise Stopped(f"stopped before any result was written{resume}") from None
        # The answer first: the report takes another second or two.
        _say(to_text(result.model, 6) + "\n")
        for note in result.notes:
            print(f"note: {note}", file=sys.stderr)
        with _progress() as watch:
            watch("drawing the report")
            report = summary(result, title, truth(), table(result.model), known[0])
            files = report_files(report, painter.paint(pictures(report)))
            write_files(out, result_files(result, resolved, files))
    print(f"\n{trust_text(report)}", file=sys.stderr)
    print(f"wrote {out}/: {', '.join(RESULT_FILES)}, figures/", file=sys.stderr)
    return report


def _say(text: str) -> None:
    """Write to standard output; a reader that has seen enough, such as head, is no error."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer goes there
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise InputError(f"cannot write to standard output: {error.strerror or error}") from error


def _compiled() -> bool:
    import odescope

    package = Path(odescope.__file__).parent
    cached = [package / "likelihood" / "__pycache__"]
    if "NUMBA_CACHE_DIR" in os.environ:
        cached += Path(os.environ["NUMBA_CACHE_DIR"]).glob("*likelihood*")
    return any(any(folder.glob("kernel.integrate-*.nbi")) for folder in cached)


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show the running stage on standard error, if that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    console = Console(stderr=True)
    with console.status("starting") as status:
        yield status.update


if __name__ == "__main__":
    main()
