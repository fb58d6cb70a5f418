"""The page of a study: its columns and options as a form, its text beside, always in step; what is valid is saved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from odescope.errors import InputError, OdescopeError
from odescope.files import write_file
from odescope.recordings.columns import check_columns
from odescope.recordings.headings import find_label
from odescope.recordings.readers import column_names
from odescope.study.columns import with_labels
from odescope.study.draft import headings_of
from odescope.study.options import Study
from odescope.study.toml import parse_study
from odescope.workbench.folder import Folder
from odescope.workbench.form import FormField, fields_of, sections
from odescope.workbench.frame import Listed, Workbench, address, aside, button, complaint, panel, show_one, text
from odescope.workbench.study_text import Setting, setting_at, with_setting, written

PAUSE = 350  # milliseconds without a key before what was typed is read
OUTSIDE = 1.0  # seconds between two looks at whether the file was changed by others
ROLES = ("left out", "coordinate", "input")
TABLES = {"coordinate": "coordinates", "input": "inputs"}


@dataclass(frozen=True)
class Checked:
    """What was found out about the text of a study: how large its libraries are, or what is wrong with it."""

    good: str
    wrong: str


def check_study(text_: str, folder: Folder, place: Path) -> Checked:
    """Return what the code that reads and runs studies says to a text.

    Args:
        text_: of the study.
        folder: that its files must lie in.
        place: the folder that the study lies in.
    """
    try:
        study = parse_study(text_)
        files = folder.files_of(study, place)
        if not files:
            raise InputError("the study names no file: add files to [data]")
        labels = column_names(files[0])
        settled = with_labels(study, labels, files[0].name)
        if not any(isinstance(i.column, tuple) for i in settled.inputs.values()):
            check_columns(settled.layout().used, labels, files[0].name)
        return Checked(_libraries(settled), "")
    except OdescopeError as error:
        return Checked("", str(error))


def _libraries(study: Study) -> str:
    """Return how many candidates there are, which takes building them."""
    form = study.library.own_form
    if form is not None and form != "relations":
        mechanisms, _ = study.mechanisms(form)
        return f"{len(mechanisms)} mechanisms to choose from"
    told = (f"{len(study.candidates(c.target))} for {c.target}" for c in study.measured())
    return f"candidate terms: {', '.join(told)}"


async def study_page(bench: Workbench, name: str) -> None:
    """Make the page of a study."""
    listed = Listed("Studies", bench.folder.studies(), "Choose a log under Data, and make a study of it.", "data")
    await show_one(bench, "study", listed, name, Editor)


class Editor:
    """A study that is edited, as a form and as text; what is not saved is wrong, and the page says what."""

    def __init__(self, bench: Workbench, name: str) -> None:
        """Open a study.

        Raises:
            InputError: it lies outside of the folder, or cannot be read.
        """
        self._bench, self._name, self._path = bench, name, bench.folder.inside(name)
        try:
            self._text = self._saved = self._path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{name} cannot be opened: {error}") from error
        self._filling, self._fields = False, list[tuple[tuple[str, ...], ui.input | ui.select]]()
        text("p", "Every change that is valid is saved at once.", "about")
        with ui.element("div").classes("status"):
            self._said = ui.element("div").props("role=status")
            self._identify = button("Identify", self._start, main=True)
        with ui.element("div").classes("two"):
            with ui.element("div").classes("form"):
                self._columns = ui.element("div")
                self._options()
            with panel("The study as text", "The same, as the command line reads it.", "first"):
                self._area = ui.textarea(value=self._text, on_change=self._typed).classes("toml")
                self._area.props(f'debounce={PAUSE} outlined autogrow spellcheck=false aria-label="the study as text"')
        self._draw_columns()
        ui.timer(0.01, self._check, once=True)
        ui.timer(OUTSIDE, self._look)

    async def _typed(self, event: ValueChangeEventArguments[Any]) -> None:
        if not self._filling:
            self._text = event.value or ""
            self._fill(area=False)
            await self._check()

    async def _set(self, path: Sequence[str], value: Setting | None) -> None:
        """Change one key, from the form."""
        try:
            self._text = with_setting(self._text, path, value)
        except InputError as error:
            self._say(Checked("", str(error)))
            return
        self._fill(area=True)
        await self._check()

    async def _check(self) -> None:
        """Say what is wrong with the text, or save it."""
        now = self._text
        checked = await aside(check_study, now, self._bench.folder, self._path.parent)
        if now != self._text:  # typed on meanwhile
            return
        if not checked.wrong and now != self._saved:
            try:
                write_file(self._path, now)
                self._saved = now
            except InputError as error:
                checked = Checked("", str(error))
        self._say(checked)

    def _say(self, checked: Checked) -> None:
        self._said.clear()
        self._identify.set_enabled(not checked.wrong)
        with self._said:
            if checked.wrong:
                complaint(f"not saved: {checked.wrong}" if self._text != self._saved else checked.wrong)
            else:
                text("p", f"valid and saved; {checked.good}", "good")

    async def _look(self) -> None:
        """Take over what others wrote to the file, unless something is being edited here."""
        try:
            there = self._path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return
        if there != self._saved and self._text == self._saved:
            self._text = self._saved = there
            self._fill(area=True)
            await self._check()

    def _fill(self, area: bool) -> None:
        """Bring the form, and the text where it did not come from there, in step with what the study says now."""
        self._filling = True
        try:
            if area:
                self._area.set_value(self._text)
            for path, control in self._fields:
                control.set_value(written(setting_at(self._text, path)))
            self._draw_columns()
        except InputError:
            pass  # no TOML: the form stays as it was, and the check says what is wrong
        finally:
            self._filling = False

    async def _start(self) -> None:
        await self._check()
        if self._text != self._saved:
            return
        try:
            job = await aside(self._bench.jobs.start, self._name)
        except InputError as error:
            self._say(Checked("", str(error)))
            return
        ui.navigate.to(address("run", job.name))

    def _options(self) -> None:
        """Make the fields of all tables but those of columns."""
        for section, kind in sections().items():
            if section in TABLES.values():
                continue
            about, fields = fields_of(kind)
            with ui.expansion(f"[{section}]").classes("options").props("dense"):
                text("p", about, "about")
                for field in fields:
                    self._field((section, field.key), field)

    def _field(self, path: tuple[str, ...], field: FormField) -> None:
        value = written(setting_at(self._text, path))

        async def changed(event: ValueChangeEventArguments[Any]) -> None:
            if self._filling:
                return
            try:
                read = field.read(event.value or "")
            except InputError as error:
                self._say(Checked("", str(error)))
                return
            await self._set(path, read)

        label = f"{field.key} ({field.unit})" if field.unit else field.key
        with ui.element("div").classes("option"):
            control = _control(field, label, value)
            control.on_value_change(changed)
            text("p", f"{field.meaning[:1].upper()}{field.meaning[1:]}", "about")
        self._fields.append((path, control))

    def _draw_columns(self) -> None:
        """Make the table that says what each column is."""
        raw, study = setting_at(self._text, ()), None
        try:
            study = parse_study(self._text)
            files = self._bench.folder.files_of(study, self._path.parent)
            labels = column_names(files[0]) if files else ()
        except OdescopeError:
            if self._columns.default_slot.children and isinstance(raw, dict):
                return  # the one that was valid last stays
            labels = ()
        self._columns.clear()
        if study is None or not labels:
            return
        with self._columns, panel("Columns", "What each is in the equations.", "first"):
            clock = study.data.time and find_label(study.data.time, labels, "the data")
            for label in dict.fromkeys(labels):
                if label != clock and label != study.data.recording:
                    self._column(label, study, labels)
            text("p", f"The time is {clock or 'given by a sample period'}.", "about")

    def _column(self, label: str, study: Study, labels: Sequence[str]) -> None:
        """Make the line of one column."""
        role, name = _role(label, study, labels)
        with ui.element("fieldset").classes("channel"):
            text("legend", label)
            select = ui.select(list(ROLES), value=role, label="it is").props("dense outlined options-dense")

            async def chosen(event: ValueChangeEventArguments[Any]) -> None:
                await self._assign(label, name, role, str(event.value))

            select.on_value_change(chosen)
            if role != "left out":
                kind = sections()[TABLES[role]]
                for field in fields_of(kind)[1]:
                    if field.key != "column":
                        self._property((TABLES[role], name, field.key), field)

    def _property(self, path: tuple[str, ...], field: FormField) -> None:
        """Make the field of one property of a column; it is drawn anew with its table."""
        value = written(setting_at(self._text, path))
        label = f"{field.key} ({field.unit})" if field.unit else field.key

        async def changed(event: ValueChangeEventArguments[Any]) -> None:
            try:
                await self._set(path, field.read(event.value or ""))
            except InputError as error:
                self._say(Checked("", str(error)))

        control = _control(field, label, value)
        control.tooltip(f"{field.meaning[:1].upper()}{field.meaning[1:]}")
        control.on_value_change(changed)

    async def _assign(self, label: str, name: str, old: str, new: str) -> None:
        """Give a column another role."""
        try:
            changed = self._text
            if old in TABLES:
                changed = with_setting(changed, (TABLES[old], name), None)
            if new in TABLES:
                made, settings = _settings(label)
                changed = with_setting(changed, (TABLES[new], name or made), settings)
        except InputError as error:
            self._say(Checked("", str(error)))
            return
        self._text = changed
        self._fill(area=True)
        await self._check()


def _control(field: FormField, label: str, value: str) -> ui.input | ui.select:
    default = f"{field.default} (default)" if field.default else "none"
    if field.choices:
        shown = {"": default, **{choice: choice for choice in field.choices}}
        return ui.select(shown, value=value if value in shown else "", label=label).props(
            "dense outlined options-dense stack-label"
        )
    made = ui.input(label, value=value, placeholder=default).props(f"dense outlined stack-label debounce={PAUSE}")
    made.props["hint"] = field.values.replace("`", "")
    return made


def _role(label: str, study: Study, labels: Sequence[str]) -> tuple[str, str]:
    """Return the role of a column in a study, and its name there."""
    for role, table in (("coordinate", study.coordinates), ("input", study.inputs)):
        for name, of in table.items():
            columns = of.column if isinstance(of.column, tuple) else (of.column or name,)
            if any(find_label(column, labels, "the data") == label for column in columns):
                return role, name
    return "left out", ""


def _settings(label: str) -> tuple[str, dict[str, Setting]]:
    """Return a name for a column that gets a role, and what its table says: the column and its unit."""
    ((name, heading),) = headings_of([label]).items()
    settings: dict[str, Setting] = {} if name == label else {"column": label}
    return name, settings | ({"unit": heading.unit} if heading.unit else {})
