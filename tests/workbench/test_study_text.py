"""Forms and texts of studies are in step, and what nobody meant stays as it is."""

import msgspec
import pytest

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.study.described import described
from odescope.study.options import Data, Driven, Measured
from odescope.study.toml import parse_study, study_toml
from odescope.workbench.form import fields_of, sections
from odescope.workbench.study_text import setting_at, with_setting, written

TEXT = """# kept
[data]
files = ["a.csv"]    # which
time = "t"           # when

[coordinates]        # each
x = { order = 2 }    # a position

[coordinates.y]
order = 1
"""


def test_one_setting_changes_and_comments_stay():
    changed = with_setting(TEXT, ("coordinates", "x", "order"), 3)
    assert changed == TEXT.replace("order = 2", "order = 3")
    changed = with_setting(TEXT, ("data", "time"), "time (ms)")
    assert changed == TEXT.replace('time = "t"  ', 'time = "time (ms)"  ')
    assert with_setting(TEXT, ("data", "time"), "t") == TEXT
    assert with_setting(TEXT, ("library", "degree"), None) == TEXT


def test_what_lacks_is_added_and_what_goes_is_gone():
    changed = with_setting(TEXT, ("random", "seed"), 4)
    assert parse_study(changed).random.seed == 4
    assert changed.startswith(TEXT)
    assert setting_at(changed, ("random", "seed")) == 4
    gone = with_setting(changed, ("coordinates", "y"), None)
    assert set(parse_study(gone).coordinates) == {"x"}
    new = with_setting(TEXT, ("inputs", "u"), {"column": "U [V]", "unit": "V"})
    assert parse_study(new).inputs["u"] == Driven(column="U [V]", unit="V")
    assert "# a position" in new


def test_wrong_texts_are_told():
    for text in ("[data", "x = "):
        with pytest.raises(InputError, match="not TOML"):
            with_setting(text, ("data", "time"), "t")
    with pytest.raises(InputError, match="no table"):
        with_setting("data = 3", ("data", "time"), "t")


def test_every_option_has_a_field_with_its_meaning():
    for kind in sections().values():
        _, fields = fields_of(kind)
        assert [f.key for f in fields] == list(kind.__struct_fields__)
        assert [f.meaning for f in fields] == [meaning for _, meaning in described(kind)[1].values()]
        assert all(f.values for f in fields)


def field(kind, key):
    return next(f for f in fields_of(kind)[1] if f.key == key)


def test_defaults_are_shown_and_read_back_as_themselves():
    """What a field shows of a default, typed into it, gives the same study."""
    base = parse_study(TEXT)
    for section, kind in sections().items():
        if section in ("coordinates", "inputs"):
            continue
        for f in fields_of(kind)[1]:
            if f.default:
                changed = with_setting(TEXT, (section, f.key), f.read(f.default))
                if f.key != "files":
                    assert parse_study(changed) == base, f.key


@pytest.mark.parametrize(
    ("kind", "key", "typed", "value"),
    [
        (Driven, "delay", "0.02", 0.02),
        (Driven, "delay", "estimate", "estimate"),
        (Driven, "hold", "zero", "zero"),
        (Driven, "column", "u, measured", "u, measured"),
        (Driven, "column", '["a", "b"]', ["a", "b"]),
        (Measured, "order", " 2 ", 2),
        (Measured, "unit", "true", "true"),
        (Measured, "angle", "true", True),
        (Measured, "angle", "", None),
        (Data, "files", "a.csv, b.csv", ["a.csv", "b.csv"]),
        (Data, "sample_period", "1e-3", 1e-3),
        (Data, "time", "3", "3"),
    ],
)
def test_what_is_typed_is_read_as_its_option_wants_it(kind, key, typed, value):
    assert field(kind, key).read(typed) == value


def test_what_cannot_be_read_is_told_with_what_is_wanted():
    with pytest.raises(InputError, match="order wants whole number; 'two' came"):
        field(Measured, "order").read("two")


def test_a_resolved_study_survives_the_form_byte_for_byte():
    text = study_toml(parse_study(TEXT))
    for path in (("data", "time"), ("coordinates", "x", "order"), ("library", "degree")):
        assert with_setting(text, path, setting_at(text, path)) == text
    assert written(setting_at(text, ("data", "files"))) == "a.csv"
    assert msgspec.toml.decode(text.encode())
