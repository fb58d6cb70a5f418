"""The command line: arguments to a study, a study to files, errors to exit codes (DESIGN 3.1)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from odescope.errors import InputError, OdescopeError

if TYPE_CHECKING:
    from odescope.identification import Identification
    from odescope.study import Study

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Read sparse, possibly rational, ordinary differential equations off noisy recorded measurements.",
)


def main() -> None:
    """Run the command line; wrong input ends with one message on standard error."""
    try:
        app()
    except OdescopeError as error:
        print(f"odescope: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print("odescope: stopped; nothing was written. Run the same command to start again", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(0)


@app.command()
def identify(
    source: Annotated[Path, typer.Argument(metavar="STUDY.toml | DATA", help="A study, or a data file with options.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results. [default: the source's name, beside it]")
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
    order: Annotated[int | None, typer.Option(help="Order of the equations of all coordinates. [default: 1]")] = None,
    recording: Annotated[str | None, typer.Option(help="Column that splits a file into recordings.")] = None,
) -> None:
    """Identify the equations behind a recording: writes model.json, candidates.csv, report.html and study.toml."""
    from odescope.study import read_study

    options = (time, sample_period, coordinate, input_, order, recording)
    if source.suffix == ".toml":
        if any(o is not None for o in options):
            raise InputError("with a study file, data options belong into the study; only --out stands beside it")
        study = read_study(source)
        folder = source.parent
    else:
        study = _study_of(source, time, sample_period, coordinate or [], input_ or [], order, recording)
        folder = Path()
    _identify_and_write(study, folder, out or source.with_name(source.name.split(".")[0] or "results"), source.stem)


@app.command()
def simulate(
    model: Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model written by identify.")],
    data: Annotated[Path, typer.Argument(metavar="DATA", help="The recording whose inputs drive it.")],
    out: Annotated[Path | None, typer.Option(help="CSV file for the states. [default: standard output]")] = None,
    time: Annotated[
        str | None, typer.Option(help="Column that holds the time. [default: as identified, else t or time]")
    ] = None,
    sample_period: Annotated[
        float | None, typer.Option(help="Sampling period in seconds, where no column has it.")
    ] = None,
    recording: Annotated[str | None, typer.Option(help="Column that splits the file into recordings.")] = None,
    initial: Annotated[
        list[str] | None, typer.Option(metavar="STATE=VALUE", help="A state at the first sample. [default: fitted]")
    ] = None,
) -> None:
    """Run a model freely from the first sample of a recording, under its inputs."""
    from odescope.freerun import free_runs

    text, notes = free_runs(model, data, time, sample_period, recording, initial or [])
    for note in notes:
        print(f"odescope: {note}", file=sys.stderr)
    if out is None:
        sys.stdout.write(text)
        return
    from odescope.results import check_writable, write_file

    check_writable(out.parent)
    write_file(out, text)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the log, the study and the results.")] = Path("odescope-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the input and the noise.")] = 0,
    level: Annotated[
        int, typer.Option(min=1, max=4, help="Noise: 1 as in the paper, each step up to ten times more.")
    ] = 1,
    friction: Annotated[float, typer.Option(min=0.0, help="Joint friction b1 in N m s.")] = 0.01,
) -> None:
    """Simulate the paper's pendulum on a cart, add noise, and identify it: prints Table 2 beside the truth."""
    from odescope.demo import cart_pendulum, table_two, write_demo
    from odescope.results import check_writable
    from odescope.study import read_study

    check_writable(out)
    out.mkdir(parents=True, exist_ok=True)
    with _progress() as watch:
        watch("simulating the pendulum on a cart")
        study = write_demo(out, seed, level, friction)
    print(f"wrote {out / 'log.csv'} and {study}", file=sys.stderr)
    result = _identify_and_write(read_study(study), out, out, "Pendulum on a cart")
    _print_table(table_two(cart_pendulum(friction), result.model))


@app.command()
def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model written by identify.")],
    to: Annotated[str, typer.Option(metavar="text|latex|python", help="What to write.")] = "text",
    out: Annotated[Path | None, typer.Option(help="File to write. [default: standard output]")] = None,
) -> None:
    """Write a model as text, as LaTeX, or as a Python module that imports numpy alone."""
    from odescope.errors import nearest
    from odescope.export.code import to_python
    from odescope.export.modelfile import read_model
    from odescope.export.text import to_latex, to_text
    from odescope.results import check_writable, write_file

    writers: dict[str, Callable[..., str]] = {"text": to_text, "latex": to_latex, "python": to_python}
    if to not in writers:
        raise InputError(f"cannot export to {to!r}; {nearest(to, writers)}")
    text = writers[to](read_model(model)).rstrip("\n") + "\n"
    if out is None:
        sys.stdout.write(text)
    else:
        check_writable(out.parent)
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
    from odescope.study import Data, Driven, Measured, Study

    if not coordinates:
        raise InputError("name at least one measured column: --coordinate NAME, or pass a study file (.toml)")
    if time is None and sample_period is None:
        raise InputError("name the column that holds the time, --time NAME, or give --sample-period SECONDS")
    measured, driven = {}, {}
    for text in coordinates:
        name, *flags = text.split(":")
        given: dict[str, int | bool] = {"order": order or 1}
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
        if flags not in ([], ["zero"], ["linear"]):
            raise InputError(f"--input {text}: after the name comes zero or linear; {':'.join(flags)!r} came")
        driven[name] = Driven(hold="zero" if flags == ["zero"] else "linear")
    data = Data(files=(str(source),), time=time, sample_period=sample_period, recording=recording)
    study = Study(data=data, coordinates=measured, inputs=driven)
    study.measured()
    return study


def _identify_and_write(study: Study, folder: Path, out: Path, title: str) -> Identification:
    import msgspec

    from odescope.export.text import to_text
    from odescope.identification import identify as run
    from odescope.report import summary, to_html
    from odescope.results import check_writable, result_files, write_files
    from odescope.study import moved, study_toml

    check_writable(out)
    placed = msgspec.structs.replace(
        study, data=msgspec.structs.replace(study.data, files=tuple(str(folder / f) for f in study.data.files))
    )
    with _progress() as watch:
        result = run(placed, watch=watch)
        resolved = moved(study, folder, out)
        html = to_html(summary(result, title, study_toml(resolved)))
        write_files(out, result_files(result, resolved, html))
    print(to_text(result.model, 6))
    print(f"\nwrote {out}/: model.json, candidates.csv, report.html, study.toml", file=sys.stderr)
    return result


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


def _print_table(rows: list) -> None:  # type: ignore[type-arg]
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Table 2: truth, paper, odescope (denominators start with 1)", title_justify="left")
    for heading in ("target", "term", "truth", "paper", "odescope"):
        table.add_column(heading, justify="left" if heading in ("target", "term") else "right")
    for row in rows:
        values = ["missing" if v is None else f"{v:.5g}" for v in (row.truth, row.paper, row.found)]
        table.add_row(row.target, row.term, *values)
    Console().print(table)


if __name__ == "__main__":
    main()
