"""The page of a run that ended without a model: what was found until then, and what to try."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from odescope.pipeline.identification import NothingFound
from odescope.report.assemble import observed
from odescope.report.figures.catalogue import Picture, early_pictures
from odescope.report.page import LISTED, inline, template
from odescope.report.reproduce import reproduce
from odescope.report.searches import searched

if TYPE_CHECKING:
    from markupsafe import Markup


def no_model_html(
    ended: NothingFound, title: str, paint: Callable[[Sequence[Picture]], Mapping[str, tuple[str, bytes]]]
) -> str:
    """Return the page; every text in it is escaped.

    Args:
        ended: what the run told before it ended.
        title: heading of the page.
        paint: draws figures, each as SVG and PNG by its name.
    """
    from markupsafe import Markup

    seen, searches = observed(ended.result), searched(ended.result)
    shown = early_pictures(seen, searches)
    drawn = paint(shown)
    figures: dict[str, list[tuple[Picture, Markup]]] = {}
    for picture in shown:
        figures.setdefault(picture.section, []).append((picture, Markup(inline(drawn[picture.name][0]))))
    return template("no_model.html.jinja").render(
        title=title,
        failure=str(ended.failure),
        advice=ended.advice,
        figures=figures,
        recorded=seen.recorded,
        searches=searches,
        listed=LISTED,
        study=reproduce(ended.result).study,
    )
