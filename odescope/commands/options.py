"""Arguments and options of the commands, each spelled once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from odescope.files import model_in

ModelFile = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL.json", help="A model written by identify, or the folder it is in.", callback=model_in
    ),
]
StatesFile = Annotated[
    Path | None, typer.Option("--out", "-o", help="CSV file for the states.", show_default="standard output")
]
Time = Annotated[
    str | None, typer.Option(help="Column that holds the time.", show_default="as identified, else t or time")
]
TimeUnitOption = Annotated[
    str | None,
    typer.Option(metavar="s|ms|us|ns|min|h|d", help="Unit of the time.", show_default="as its heading says, else s"),
]
SamplePeriod = Annotated[float | None, typer.Option(help="Sampling period in seconds, where no column has it.")]
Recording = Annotated[str | None, typer.Option(help="Column that splits files into recordings.")]
GapsOption = Annotated[
    str | None, typer.Option(metavar="bridge|split|refuse", help="What to do about gaps.", show_default="bridge")
]
DelayOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="INPUT=SECONDS|estimate", help="How late an input acts; repeat for more.", show_default="found"
    ),
]
BasisOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FUNCTION,...",
        help="What terms are products of, such as x,x_dot,sin(phi),u.",
        show_default="by the coordinates",
    ),
]
DegreeOption = Annotated[int | None, typer.Option(help="Most factors of a term of the basis.", show_default="3")]
ClusterOption = Annotated[
    str | None,
    typer.Option(metavar="local | tcp://HOST:PORT", help="Run on Dask workers, which read the files where they lie."),
]
Seconds = Annotated[
    float | None,
    typer.Option(help="End the searches so long after the run began, with the best model so far."),
]
EventsFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write what the run tells to a file as it goes, as lines of JSON."),
]
Sources = Annotated[
    list[Path],
    typer.Argument(metavar="STUDY.toml | DATA ...", help="A study; or data files, folders, patterns, with options."),
]
DataFiles = Annotated[list[Path], typer.Argument(metavar="DATA ...", help="Data files, folders and patterns.")]
