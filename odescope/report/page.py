"""The page: plain data and drawn figures to one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

from odescope.library.mathml import math, mathml_name
from odescope.model.display import product_mathml, quotient_mathml, relation_mathml
from odescope.model.notes import trust
from odescope.model.relation import RelationTerm
from odescope.model.scores import Likelihood, Step
from odescope.report.assemble import model_of, to_json_text
from odescope.report.data import Report
from odescope.report.figures.catalogue import Picture, draw_job, pictures
from odescope.report.numerals import raised as exponent_digits

if TYPE_CHECKING:
    from markupsafe import Markup

LISTED = 6  # candidates of a target in the table
LISTED_LIMITS = 12  # absent terms shown without asking for more
MOST_LISTED = 60  # limits and correlations


def to_html(report: Report, drawn: Mapping[str, str] | None = None) -> str:
    """Return the page; every text in it is escaped.

    Args:
        report: see `summary`.
        drawn: the SVG of every figure by name; they are drawn here without it.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    shown = pictures(report)
    if drawn is None:
        drawn = {p.name: draw_job(p.job)[0] for p in shown}
    environment = Environment(
        loader=PackageLoader("odescope.report", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"number": number, "bytes": in_bytes, "span": in_time, "joints": joints}
    figures: dict[str, list[tuple[Picture, Markup]]] = {}
    for picture in shown:
        figures.setdefault(picture.section, []).append((picture, Markup(inline(drawn[picture.name]))))
    model = model_of(report)
    judged = None if model.scores is None else model.scores.likelihood
    return environment.get_template("page.html.jinja").render(
        r=report,
        model=model,
        equations=_equations(report),
        trust=trust(model.scores),
        likelihood=judged,
        limits=((judged and judged.limits) or ())[:MOST_LISTED],
        correlations=((judged and judged.correlations) or ())[:MOST_LISTED],
        figures=figures,
        listed=LISTED,
        listed_limits=LISTED_LIMITS,
    )


def report_files(report: Report, drawn: Mapping[str, tuple[str, bytes]]) -> dict[str, str | bytes]:
    """Return the files of a report by name: the page, its data, and every figure as SVG and as PNG."""
    files: dict[str, str | bytes] = {
        "report.html": to_html(report, {name: svg for name, (svg, _) in drawn.items()}),
        "report.json": to_json_text(report),
    }
    for name, (svg, png) in drawn.items():
        files |= {f"figures/{name}.svg": svg, f"figures/{name}.png": png}
    return files


@dataclass(frozen=True)
class Equation:
    """One target's equation as the page shows it."""

    target: Markup
    explicit: Markup
    relation: Markup
    rows: tuple[tuple[Markup, str, str, str, str], ...]
    stated: bool


def _equations(report: Report) -> list[Equation]:
    from markupsafe import Markup

    model = model_of(report)
    found = []
    for quotient, relation, units in zip(model.quotients, model.relations, report.coefficients, strict=True):
        rows = []
        for term, more in zip(relation.terms, units, strict=True):
            error = "" if term.std_error is None else with_error(term.coefficient, term.std_error)[1]
            value = number(term.coefficient, 6) if not error else with_error(term.coefficient, term.std_error or 0.0)[0]
            rows.append((Markup(_small(product_mathml(term))), value, error, _interval(term), more.unit))
        found.append(
            Equation(
                Markup(_small(mathml_name(quotient.target))),
                Markup(math(quotient_mathml(quotient))),
                Markup(math(relation_mathml(relation))),
                tuple(rows),
                any(t.std_error is not None for t in relation.terms),
            )
        )
    return found


def _interval(term: RelationTerm) -> str:
    """Return the 95 % interval of a coefficient, to the place of its error's second digit."""
    if term.interval is None or term.std_error is None:
        return ""
    return " to ".join(with_error(end, term.std_error)[0] for end in term.interval)


def _small(body: str) -> str:
    return math(body).replace(' display="block"', "")


def inline(svg: str) -> str:
    """Return an SVG file as an element of a page: without its prologue and its fixed size."""
    head, _, rest = svg[svg.index("<svg") :].partition(">")
    box = head[head.index('viewBox="') :].split('"')[1]
    return f'<svg viewBox="{box}" aria-hidden="true" xmlns:xlink="http://www.w3.org/1999/xlink">{rest}'


def number(value: float | None, digits: int = 4) -> str:
    """Return a number for people: a real minus sign, powers of ten only where they help, "–" for none."""
    if value is None or not isfinite(value):
        return "–"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -5 < power < 7:
        fixed = f"{value:.{max(digits - 1 - power, 0)}f}".replace("-", "−")
        return fixed.rstrip("0").rstrip(".") if "." in fixed else fixed
    return f"{mantissa}·10{exponent_digits(power)}".replace("-", "−")


def with_error(value: float, error: float) -> tuple[str, str]:
    """Return a coefficient and its standard error to the same place, the error to two digits."""
    if not 0.0 < error < abs(value) or not 1e-7 < error < 1e7 or abs(value) >= 1e10:
        return number(value, 6), number(error, 2)
    size = f"{error:.1e}"
    places = max(1 - int(size.partition("e")[2]), 0)
    return f"{value:.{places}f}".replace("-", "−"), f"{error:.{places}f}"


def joints(step: Step, likelihood: Likelihood) -> str:
    """Return what segments may differ by at their joints in a step of the likelihood's search."""
    if step.gap is not None:
        return f"{step.gap:g}"
    return "apart" if likelihood.process_noise is None else "estimated"


def in_bytes(count: int | None) -> str:
    """Return an amount of memory."""
    return "–" if count is None else f"{count / 1e6:.0f} MB"


def in_time(seconds: float) -> str:
    """Return a length of time."""
    if seconds >= 7200.0:
        return f"{seconds / 3600.0:.3g} h"
    return f"{seconds / 60.0:.3g} min" if seconds >= 120.0 else f"{seconds:.4g} s"
