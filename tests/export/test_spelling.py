from odescope.export.spelling import Names, renamed

NAMES = Names(frozenset({"end", "end_", "sin"}), longest=8)


def test_what_a_language_takes_stays_and_the_rest_is_told_apart():
    names = ["x", "end", "sin", "sin_", "_y", "v_y", "a_long_name", "a_long_nose"]
    found = NAMES.spelled(names)
    assert list(found) == names
    assert len(set(found.values())) == len(names)
    assert all(len(other) <= 8 and not other.startswith("_") for other in found.values())
    assert not set(found.values()) & NAMES.reserved
    assert [found[n] for n in ("x", "sin_", "v_y")] == ["x", "sin_", "v_y"]
    assert [found[n] for n in ("end", "sin", "_y")] == ["end_2", "sin_2", "v_y_"]
    assert renamed({"x": "x", "end": "end_2"}) == ("end is written end_2",)


def test_an_underscore_may_begin_a_name_where_the_language_says_so():
    assert Names(frozenset({"_y"}), underscore=True).spelled(["_y", "_z"]) == {"_y": "_y_", "_z": "_z"}
    assert Names(frozenset()).spelled(["_z"]) == {"_z": "v_z"}
