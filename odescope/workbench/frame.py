"""What every page of the workbench has: its head, its navigation, and small parts that several use."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from inspect import isawaitable
from typing import TypeVar
from urllib.parse import quote, urlencode

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement

from odescope.errors import InputError, OdescopeError
from odescope.workbench.folder import Folder
from odescope.workbench.jobs import Jobs

Found = TypeVar("Found")
IDENTIFY = "Open a study and press Identify."
VIEWS = (("data", "Data"), ("study", "Study"), ("run", "Run"), ("look", "Look"), ("try", "Try"), ("take", "Take away"))


@dataclass(frozen=True)
class Workbench:
    """What all pages work on: the folder, and the runs in it."""

    folder: Folder
    jobs: Jobs


@dataclass(frozen=True)
class Listed:
    """What a page shows one of.

    Attributes:
        label: of the list.
        names: in the list.
        begin: how to come by the first, as long as there is none.
        view: where that is done, of VIEWS; the page's own needs no link.
        remarks: what is said beside some of the names.
    """

    label: str
    names: Sequence[str]
    begin: str
    view: str
    remarks: Mapping[str, str] = field(default_factory=dict)


def stored(result: str, file: str) -> str:
    """Return the address of a file of a result; names may hold what means something in an address."""
    return f"/stored/{quote(f'{result}/{file}')}"


def address(view: str, given: str = "", key: str = "name") -> str:
    """Return the address of a page.

    Args:
        view: of VIEWS.
        given: what is shown there.
        key: what that is called in the address.
    """
    return f"/{view}" + (f"?{urlencode({key: given})}" if given else "")


async def show_one(
    bench: Workbench, view: str, listed: Listed, name: str, fill: Callable[[Workbench, str], object]
) -> None:
    """Make a page that shows one thing beside the list of all; what cannot be shown is said in its place.

    Args:
        bench: whose page it is.
        view: of VIEWS.
        listed: what there is to choose from.
        name: that was asked for; where that is no text, the first in the list is shown.
        fill: puts what has a name on the page, below its heading, at once or awaited; InputError says why it cannot.
    """
    chosen = name or next(iter(listed.names), "")
    with frame(bench, view, chosen), ui.element("div").classes("split"):
        chooser(view, listed, chosen)
        with ui.element("div").classes("content"):
            text("h1", chosen or f"No {listed.label.lower()} here yet")
            if not chosen:
                text("p", listed.begin, "about")
                if listed.view != view:
                    link(dict(VIEWS)[listed.view], address(listed.view))
                return
            try:
                filling = fill(bench, chosen)
                if isawaitable(filling):
                    await filling
            except InputError as error:
                complaint(str(error))


async def show_result(bench: Workbench, view: str, name: str, fill: Callable[[Workbench, str], object]) -> None:
    """Make a page that shows one result.

    Args:
        bench: whose page it is.
        view: of VIEWS.
        name: that was asked for.
        fill: as for `show_one`.
    """
    await show_one(bench, view, Listed("Results", bench.folder.results(), IDENTIFY, "study"), name, fill)


@contextmanager
def frame(bench: Workbench, view: str, name: str = "") -> Iterator[None]:
    """Put what is made inside into a page.

    Args:
        bench: whose page it is.
        view: of VIEWS.
        name: of what is shown, for the title.
    """
    shown = dict(VIEWS)[view]
    ui.page_title(f"{shown}{f', {name}' if name else ''} – odescope")
    ui.add_head_html(
        f"<style>{files('odescope.workbench').joinpath('workbench.css').read_text(encoding='utf-8')}</style>"
    )
    ui.colors(primary="#00517d", negative="#b3261e", positive="#00694a")
    with ui.element("header").classes("bar"):
        text("span", "odescope", "wordmark")
        with ui.element("nav").props('aria-label="Views"').classes("views"):
            for target, label in VIEWS:
                link(label, f"/{target}", "here" if target == view else "", current=target == view)
        text("span", bench.folder.root.name, "place").props["title"] = str(bench.folder.root)
    with ui.element("div").classes("page"):
        yield


def text(tag: str, content: str, classes: str = "") -> TextElement:
    """Return an element that holds text as it is: nothing in it is markup.

    Args:
        tag: of the element.
        content: the text.
        classes: of its style.
    """
    return TextElement(tag=tag, text=content).classes(classes)


def link(label: str, target: str, classes: str = "", *, current: bool = False, new_tab: bool = False) -> ui.element:
    """Return a link within the workbench.

    Args:
        label: what it says.
        target: an address.
        classes: of its style.
        current: whether it leads to where one is.
        new_tab: whether it opens beside.
    """
    made = text("a", label, classes)
    made.props["href"] = target
    if current:
        made.props["aria-current"] = "page"
    if new_tab:
        made.props["target"] = "_blank"
    return made


def panel(heading: str, about: str = "", classes: str = "") -> ui.element:
    """Return a part of a page under a heading, to be filled.

    Args:
        heading: of the part.
        about: a sentence below it.
        classes: of its style.
    """
    made = ui.element("section").classes(f"panel {classes}")
    made.props["aria-label"] = heading
    with made:
        text("h2", heading)
        if about:
            text("p", about, "about")
    return made


def button(label: str, pressed: Callable[[], object], *, main: bool = False, danger: bool = False) -> ui.button:
    """Return a button.

    Args:
        label: what it says.
        pressed: called when it is.
        main: whether it is what one came for.
        danger: whether it ends something.
    """
    made = ui.button(label, on_click=pressed).props("no-caps unelevated" if main else "no-caps outline")
    return made.props("color=negative") if danger else made


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> None:
    """Make a table of texts.

    Args:
        caption: above it.
        heads: of the columns.
        rows: of texts.
        numbers: the columns that are set to the right.
    """
    around = ui.element("div").classes("scroll").props("tabindex=0 role=group")
    around.props["aria-label"] = caption
    with around, ui.element("table"):
        text("caption", caption)
        with ui.element("tr"):
            for k, head in enumerate(heads):
                text("th", head, "n" if k in numbers else "").props("scope=col")
        for row in rows:
            with ui.element("tr"):
                for k, cell in enumerate(row):
                    text("td", cell, "n" if k in numbers else "wrap")


def markup(html: str, classes: str = "") -> ui.html:
    """Return markup of odescope's own, sanitized in the browser all the same.

    Args:
        html: in which all that came from files is escaped.
        classes: of its style.
    """
    return ui.html(html).classes(classes)


def complaint(said: str) -> None:
    """Say on the page what is wrong."""
    text("p", said, "complaint").props("role=alert")


def told(act: Callable[[], object]) -> Callable[[], None]:
    """Return an act whose errors are told in the corner of the page."""

    def done() -> None:
        try:
            act()
        except InputError as error:
            ui.notify(str(error), type="negative", multi_line=True, timeout=10_000, close_button="Close")

    return done


async def aside(act: Callable[..., Found], *given: object) -> Found:
    """Return what a function returns that is called beside the server's thread, which goes on serving.

    Args:
        act: the function.
        given: its arguments.

    Raises:
        asyncio.CancelledError: the server ends.
    """
    found = await run.io_bound(act, *given)
    if found is None:
        raise asyncio.CancelledError
    return found


def chooser(view: str, listed: Listed, chosen: str) -> None:
    """Make the list of what a page may show; what is chosen stands in the address, where a reload finds it.

    Args:
        view: of VIEWS.
        listed: what there is to choose from.
        chosen: that is shown.
    """
    around = ui.element("nav").classes("chooser")
    around.props["aria-label"] = listed.label
    with around:
        text("h2", listed.label)
        for name in listed.names:
            with link(name, address(view, name), "here" if name == chosen else "", current=name == chosen):
                if name in listed.remarks:
                    text("span", f" {listed.remarks[name]}", "about")


class Latest:
    """What is asked for again before it is there, as by a slider: one at a time, and the last alone is shown."""

    def __init__(self) -> None:
        """Begin with nothing asked for."""
        self._asked, self._turn = 0, asyncio.Lock()

    async def of(self, act: Callable[..., Found], *given: object) -> Found | None:
        """Return what a function returns, as `aside`; None where it was asked for again meanwhile.

        Args:
            act: the function.
            given: its arguments.

        Raises:
            OdescopeError: the function says so.
        """
        self._asked += 1
        mine = self._asked
        async with self._turn:
            if mine != self._asked:
                return None
            try:
                found = await aside(act, *given)
            except OdescopeError:
                if mine == self._asked:
                    raise
                return None
        return found if mine == self._asked else None
