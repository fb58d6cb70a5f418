"""The page: plain data and drawn figures to one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING

from odescope.library.mathml import math, mathml_name
from odescope.library.mechanism import FORCE_ON
from odescope.library.numerals import raised as exponent_digits
from odescope.library.parse import Scope
from odescope.model.cautions import cautions
from odescope.model.choice_notes import findings
from odescope.model.display import parameters_mathml, product_mathml, relation_mathml, stated_mathml
from odescope.model.mechanism_display import HEADINGS, by_kind, mechanisms_mathml, reaction_mathml, term_mathml
from odescope.model.notes import trust
from odescope.model.quantity_units import quantity_units
from odescope.model.quantity_units import shown as shown_unit
from odescope.model.relation import FoundMechanism, RelationTerm
from odescope.model.rounding import places, rounded
from odescope.model.scores import Likelihood, PathScore, Step
from odescope.report.assemble import model_of, to_json_text
from odescope.report.data import Report
from odescope.report.figures.catalogue import Picture, draw_job, pictures
from odescope.report.units import mechanism_units

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup

PAGE = "page.html.jinja"
LISTED = 6  # candidates of a target in the table
LISTED_LIMITS = 12  # absent terms shown without asking for more
MOST_LISTED = 60  # limits and correlations


@cache  # to compile one takes as long as to fill it
def template(name: str) -> Template:
    """Return the template of a page, in which all that is put is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("odescope.report", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"number": number, "bytes": in_bytes, "span": in_time, "joints": joints}
    return environment.get_template(name)


def to_html(report: Report, drawn: Mapping[str, str] | None = None) -> str:
    """Return the page; every text in it is escaped.

    Args:
        report: see `summary`.
        drawn: the SVG of every figure by name; they are drawn here without it.
    """
    from markupsafe import Markup

    shown = pictures(report)
    if drawn is None:
        drawn = {p.name: draw_job(p.job)[0] for p in shown}
    figures: dict[str, list[tuple[Picture, Markup]]] = {}
    for picture in shown:
        figures.setdefault(picture.section, []).append((picture, Markup(inline(drawn[picture.name]))))
    return template(PAGE).render(_context(report), figures=figures)


def sections_html(report: Report) -> dict[str, str]:
    """Return the sections of the page by their names, without figures, and its "style"."""
    page = template(PAGE)
    context = page.new_context({**_context(report), "figures": {}})
    "".join(page.root_render_func(context))  # which defines what its parts share
    return {name: "".join(block(context)) for name, block in page.blocks.items()}


def _context(report: Report) -> dict[str, object]:
    """Return what the template of the page says of a report, but for its figures."""
    from markupsafe import Markup

    model = model_of(report)
    found = findings(model.scores)
    path = () if model.scores is None or len(model.scores.path) < 2 else model.scores.path
    judged = None if model.scores is None else model.scores.likelihood
    equations = tuple(
        Markup(math(e))
        for e in (
            *(stated_mathml(e, model.shown_relations) for e in model.equations),
            *parameters_mathml(model.parameters),
        )
    )
    return {
        "r": report,
        "model": model,
        "equations": equations,
        "formulas": tuple(Markup(math(f)) for f in mechanisms_mathml(model.shown_mechanisms, model.names)),
        "mechanisms": _mechanisms(report),
        "relations": _relations(report),
        "trust": trust(model.scores),
        "found": [line for line in found if line not in report.warnings],
        "bracketed": any("<mtext>(" in e for e in equations),
        "cautions": cautions(model, {name: shown_unit(own) for name, own in quantity_units(model).items()}),
        "notes": [note for note in report.notes if note not in (*found, *report.warnings)],
        "likelihood": judged,
        "limits": ((judged and judged.limits) or ())[:MOST_LISTED],
        "correlations": ((judged and judged.correlations) or ())[:MOST_LISTED],
        "path": path,
        "another": _another(path),
        "listed": LISTED,
        "listed_limits": LISTED_LIMITS,
    }


def report_files(report: Report, drawn: Mapping[str, tuple[str, bytes]]) -> dict[str, str | bytes]:
    """Return the files of a report by name: the page, its data, and every figure as SVG and as PNG."""
    files: dict[str, str | bytes] = {
        "report.html": to_html(report, {name: svg for name, (svg, _) in drawn.items()}),
        "report.json": to_json_text(report),
    }
    for name, (svg, png) in drawn.items():
        files |= {f"figures/{name}.svg": svg, f"figures/{name}.png": png}
    return files


def _another(path: Sequence[PathScore]) -> int:
    """Return the number of terms of a model on the path that could be taken instead: the one before the choice."""
    chosen = next((k for k, step in enumerate(path) if step.chosen), 0)
    return path[chosen - 1 if chosen else 1].terms if path else 0


Row = tuple["Markup", str, str, str, str]  # what a coefficient stands before; it, its error, interval and unit


@dataclass(frozen=True)
class ShownRelation:
    """A relation as the page shows it: a sum that is zero, and its coefficients."""

    relation: Markup
    rows: tuple[Row, ...]
    stated: bool


def _relations(report: Report) -> list[ShownRelation]:
    from markupsafe import Markup

    found = []
    for relation, units in zip(model_of(report).shown_relations, report.coefficients, strict=True):
        rows = tuple(
            (Markup(_small(product_mathml(term))), *_numbers(term), more.unit)
            for term, more in zip(relation.terms, units, strict=True)
        )
        stated = any(t.std_error is not None for t in relation.terms)
        found.append(ShownRelation(Markup(math(relation_mathml(relation))), rows, stated))
    return found


def _mechanisms(report: Report) -> list[tuple[str, list[Row]]]:
    """Return the mechanisms of the model by headings."""
    from markupsafe import Markup

    model = model_of(report)
    scope, units = Scope.of(model.names, constants=model.names), mechanism_units(model)
    written = dict(zip(model.mechanisms, model.shown_mechanisms, strict=True))

    def shown(m: FoundMechanism) -> Markup:
        if m.kind == "reaction":
            return Markup(_small(reaction_mathml(m.name)))
        term, on = Markup(_small(term_mathml(written[m].term, scope))), m.name.rpartition(FORCE_ON)[2]
        return term + Markup(" on ") + Markup(_small(mathml_name(on))) if m.kind == "force" else term

    return [
        (HEADINGS[kind], [(shown(m), *_numbers(m), units[m]) for m in members])
        for kind, members in by_kind(model.mechanisms).items()
    ]


def _numbers(of: RelationTerm | FoundMechanism) -> tuple[str, str, str]:
    """Return a coefficient, its standard error and its 95 % interval, to the place of the error's second digit."""
    if of.std_error is None or of.interval is None:
        return number(of.coefficient, 6), "", ""
    value, error = with_error(of.coefficient, of.std_error)
    return value, error, " to ".join(with_error(end, of.std_error)[0] for end in of.interval)


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
    if places(value, error) is None:
        return number(value, 6), number(error, 2)
    shown, shown_error = rounded(value, error)
    return shown.replace("-", "−"), shown_error


def joints(step: Step, likelihood: Likelihood) -> str:
    """Return what segments may differ by at their joints in a step of the likelihood's search."""
    if step.gap is not None:
        return f"{step.gap:g}"
    return "apart" if likelihood.process_noise is None else "estimated"


def in_bytes(count: int | None) -> str:
    """Return an amount of memory, or the size of a file."""
    if count is None:
        return "–"
    return f"{count / 1e6:,.0f} MB" if count >= 1e7 else f"{count / 1e3:,.0f} kB"


def in_time(seconds: float) -> str:
    """Return a length of time."""
    if seconds >= 7200.0:
        return f"{seconds / 3600.0:.3g} h"
    return f"{seconds / 60.0:.3g} min" if seconds >= 120.0 else f"{seconds:.4g} s"
