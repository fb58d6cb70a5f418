import copy
import json
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hand_models import MODELS

from odescope.errors import InputError
from odescope.export.model_file import from_json, read_model, to_json
from odescope.model.relation import FoundMechanism, FoundParameter
from odescope.model.scores import ModelScores, SuspicionScore, TargetScore

TOP = {
    "format",
    "version",
    "coordinates",
    "inputs",
    "states",
    "targets",
    "relations",
    "explicit",
    "scores",
    "domain",
    "provenance",
}
GOOD = json.loads(to_json(MODELS["rational"]))


def refused(content):
    with pytest.raises(InputError) as caught:
        from_json(content if isinstance(content, str | bytes) else json.dumps(content))
    assert "\n" not in str(caught.value)
    return str(caught.value)


# writing


def test_a_constant_within_functions_has_the_keys_of_the_contract_and_is_shown_by_name_when_read_back():
    held, shown = ("x/(2.0 + x)",), ("x/(K + x)",)
    model = replace(MODELS["rational"], parameters=(FoundParameter("K", 2.0, 0.1, held, shown),))
    file = json.loads(to_json(model))
    assert file["parameters"] == [{"name": "K", "value": 2.0, "std_error": 0.1, "terms": list(held)}]
    assert file["provenance"]["named_terms"] == {"K": list(shown)}
    back = from_json(json.dumps(file))
    assert (back.parameters, back.provenance) == (model.parameters, model.provenance)
    file["provenance"]["named_terms"] = {"K": "x"}
    assert "named_terms" in refused(file)


def test_numbers_that_numpy_computed_are_written_as_numbers():
    suspected = SuspicionScore(
        "x_dot", "x", "powers", 2, np.float64(0.1), np.float64(3.0), ("sqrt(x)",), (), np.float64(7.5)
    )
    model = replace(MODELS["rational"], scores=ModelScores(suspicions=(suspected,)))
    (file,) = json.loads(to_json(model))["scores"]["suspicions"]
    assert (file["low"], file["high"], file["gain"]) == (0.1, 3.0, 7.5)
    with pytest.raises(NotImplementedError, match="object"):
        to_json(replace(MODELS["rational"], provenance={"what": object()}))


@pytest.mark.parametrize("name", MODELS)
def test_the_keys_are_those_of_the_contract(name):
    file = json.loads(to_json(MODELS[name]))
    assert set(file) == TOP
    assert (file["format"], file["version"]) == ("odescope/model", 1)
    for items, keys in (
        (file["coordinates"], {"name", "order", "angle", "cyclic", "unit"}),
        (file["inputs"], {"name", "hold", "unit"}),
        (file["relations"], {"terms"}),
        ([t for r in file["relations"] for t in r["terms"]], {"factor", "term", "coefficient", "std_error"}),
    ):
        assert all(set(item) == keys for item in items)
    assert set(file["explicit"]) == set(file["targets"])


def test_what_the_file_says():
    assert GOOD["states"] == ["x", "phi", "x_dot", "phi_dot"]
    assert GOOD["targets"] == ["x_ddot", "phi_ddot"]
    assert GOOD["coordinates"][0] == {"name": "x", "order": 2, "angle": False, "cyclic": True, "unit": "m"}
    assert GOOD["inputs"][1] == {"name": "v", "hold": "zero", "unit": None}
    first = GOOD["relations"][0]["terms"]
    assert first[0] == {"factor": "x_ddot", "term": "1", "coefficient": 1.0, "std_error": None}
    assert first[1] == {
        "factor": "x_ddot",
        "term": "cos(phi)**2",
        "coefficient": -0.30000000000000004,
        "std_error": 1e-3,
    }
    assert [t["std_error"] for t in first[2:]] == [2e-300, None, 0.0, None]
    assert GOOD["scores"] == {
        "targets": {
            "x_ddot": {
                "r2_held_out": 0.30000000000000004,
                "rmse_held_out": 1e-17,
                "explained_held_out": 0.75,
                "condition": None,  # JSON has no infinity
                "denominator": {"data": [0.1, 1.0], "box": [-0.1, 1.0]},
            }
        },
        "free_runs": [{"duration": 13.0, "valid_time": 1 / 3}],
    }


@pytest.mark.parametrize("name", MODELS)
def test_a_model_reads_back_as_it_was_to_the_last_digit(name):
    model = MODELS[name]
    text = to_json(model)
    again = from_json(text)
    assert again.relations == model.relations
    assert (again.coordinates, again.inputs) == (model.coordinates, model.inputs)
    assert (again.domain, again.provenance) == (model.domain, model.provenance)
    assert (again.scores is None) == (model.scores is None)
    assert to_json(again) == text
    assert math.isfinite(json.loads(text, parse_constant=lambda _: math.nan)["relations"][0]["terms"][0]["coefficient"])


def test_the_file_is_plain_json_that_people_can_read():
    text = to_json(MODELS["coupled"])
    assert text.endswith("}\n")
    assert '\n  "version": 1,\n' in text
    assert msgspec.json.decode(text) == json.loads(text)


# reading


@pytest.mark.parametrize("key", sorted(TOP))
def test_a_missing_key_is_named(key):
    assert f"`{key}`" in refused({k: v for k, v in GOOD.items() if k != key})


@pytest.mark.parametrize(
    "path", [[], ["coordinates", 0], ["inputs", 1], ["relations", 0], ["relations", 1, "terms", 2]], ids=str
)
def test_an_extra_key_is_named_with_its_place(path):
    file = copy.deepcopy(GOOD)
    place = file
    for step in path:
        place = place[step]
    place["surprise"] = 1
    message = refused(file)
    assert "`surprise`" in message
    assert all(str(step) in message for step in path)
    missing = sorted(set(place) - {"surprise"})[0]
    del place["surprise"], place[missing]
    assert f"`{missing}`" in refused(file)


def changed(**values):
    return GOOD | values


def term(**values):
    file = copy.deepcopy(GOOD)
    file["relations"][0]["terms"][2] |= values
    return file


@pytest.mark.parametrize(
    ("content", "part"),
    [
        ("", "truncated"),
        ("{", "truncated"),
        ("null", "`object`"),
        ("[" * 100_000, "`object`"),
        ('{"scores": ' * 100_000, "nested too deep"),
        (b"\xff\xfe", "JSON"),
        (json.dumps(GOOD) + "x", "trailing"),
        (json.dumps(term(coefficient=float("nan"))), "JSON"),
        (json.dumps(term(coefficient=float("inf"))), "JSON"),
        (term(coefficient="1.0"), "`relations[0].terms[2].coefficient`"),
        (term(std_error=-1e-9), "standard error of 'u' is negative"),
        (term(factor="y_ddot"), "'y_ddot' is no target; the targets are x_ddot, phi_ddot"),
        (term(term="y"), "'y'"),
        (term(term="x_ddot"), "'x_ddot'"),
        (term(term="x + 1"), "one product"),
        (term(term="2*x"), "one product"),
        (term(term=""), "not an expression"),
        (term(term="__import__('os')"), "only names"),
        (term(term="__import__('os').system('touch pwned')"), "only names"),
        (term(term="x.__class__"), "only names"),
        (term(term="(lambda: 0)()"), "only names"),
        (term(term="9**9**9"), "exponent"),
        (term(term="x**9**9**9"), "exponent"),
        (term(term="x**99"), "exponent"),
        (term(term="(" * 3000 + "x" + ")" * 3000), "6001 characters"),
        (term(term="sin(" * 3000 + "x" + ")" * 3000), "15001 characters"),
        (term(term="-" * 900 + "x"), "nested"),
        (changed(version=2), "version is not 1"),
        (changed(version="1"), "version is not 1"),
        (changed(format="sbml"), "odescope/model"),
        (changed(relations=[]), "2 targets needs as many relations; 0 came"),
        (changed(relations=[{"terms": []}] * 2), "holds no target"),
        (changed(coordinates=[]), "no coordinate"),
        (changed(states=["phi", "x", "x_dot", "phi_dot"]), "its states are phi, x, x_dot, phi_dot, but"),
        (changed(targets=["x_ddot"]), "its targets are x_ddot, but"),
        (changed(inputs=[]), "'u'"),
        (changed(inputs=[{"name": "x", "hold": "zero", "unit": None}]), "'x' is used twice"),
        (changed(inputs=[{"name": "u", "hold": "foh", "unit": None}]), "inputs[0].hold"),
        (changed(domain={"x": [1.0]}), "length 2"),
        (changed(scores=[]), "`scores`"),
        (changed(scores={"targets": {"x_ddot": {"r2_held_out": "good"}}}), "`scores.targets[...].r2_held_out`"),
        (changed(scores={"free_runs": [{"ended": None}]}), "`duration` - at `scores.free_runs[0]`"),
        (changed(scores={"likelihood": True}), "`scores.likelihood`"),
        (changed(scores={"left_out": 1.5}), "`scores.left_out`"),
    ],
)
def test_what_is_wrong_is_named(content, part):
    assert part in refused(content)


@pytest.mark.parametrize(
    ("field", "value", "part"),
    [("name", "x y", "not a plain name"), ("order", 0, "order"), ("order", 10**6, "order"), ("angle", 1, "`bool`")],
)
def test_a_coordinate_that_cannot_be(field, value, part):
    file = copy.deepcopy(GOOD)
    file["coordinates"][0][field] = value
    assert part in refused(file)


@pytest.mark.parametrize("unit", ["deg", "°", "Degrees"])
def test_an_angle_in_degrees_is_refused_with_what_to_write(unit):
    """Its equations are in radians, and every result would call these degrees."""
    file = copy.deepcopy(GOOD)
    (angle,) = [c for c in file["coordinates"] if c["angle"]]
    angle["unit"] = unit
    message = refused(file)
    assert '"unit": "rad"' in message
    assert f'"degrees": ["{angle["name"]}"]' in message
    angle["angle"] = False
    assert from_json(json.dumps(file)).coordinates[file["coordinates"].index(angle)].unit == unit


@pytest.mark.parametrize("scores", [{}, {"r2": 0.9, "worst": {"x": None}}])
def test_scores_that_say_nothing_known_are_none(scores):
    model = from_json(json.dumps(changed(scores=scores)))
    assert model.scores is None
    assert json.loads(to_json(model))["scores"] == {}
    assert "<li>" not in model._repr_html_()


def test_scores_of_someone_else_are_read_as_far_as_they_are_known():
    told = {"author": "by hand", "targets": {"x_ddot": {"r2_held_out": 0.875, "grade": "A"}}, "left_out": 2}
    model = from_json(json.dumps(changed(scores=told)))
    assert model.scores == ModelScores(targets={"x_ddot": TargetScore(r2_held_out=0.875)}, left_out=2)
    assert "87.50 % of the variance of x_ddot" in model._repr_html_()


def test_explicit_is_for_people_and_never_read():
    file = changed(explicit={"x_ddot": "__import__('os').system('touch pwned')", "phi_ddot": "nonsense"})
    assert from_json(json.dumps(file)).relations == MODELS["rational"].relations


def test_reading_a_file_names_it(tmp_path):
    path = tmp_path / "model.json"
    with pytest.raises(InputError, match=r"cannot read the model .*model.json: No such file"):
        read_model(path)
    path.write_text("{}")
    with pytest.raises(InputError, match=r"model.json is not a model that odescope can read: .*`format`"):
        read_model(path)
    for other in ('[data]\nfiles = ["a.csv"]\n', "t,x\n0,1\n", "[1, 2]"):
        path.write_text(other)
        with pytest.raises(
            InputError, match=r"expected the model.json of odescope identify, or the folder that it is in"
        ):
            read_model(path)
    path.write_text(to_json(MODELS["coupled"]))
    assert read_model(path).relations == MODELS["coupled"].relations


# mechanisms


MECHANISMS = (
    FoundMechanism("x_dot**2", "kinetic", "x_dot**2", 0.1 + 0.2, 1e-300),
    FoundMechanism("cos(phi)", "potential", "cos(phi)", -1 / 3, None),
    FoundMechanism("u on x", "force", "u", 1.0, None),
    FoundMechanism("S + E -> C", "reaction", "S*E", 5e-324, 0.0),
)
MECHANICAL = to_json(replace(MODELS["rational"], mechanisms=MECHANISMS))


def test_mechanisms_read_back_as_they_were_to_the_last_digit():
    again = from_json(MECHANICAL)
    assert again.mechanisms == MECHANISMS
    assert again.relations == MODELS["rational"].relations
    assert to_json(again) == MECHANICAL
    file = json.loads(MECHANICAL)
    assert set(file) == TOP | {"mechanisms"}
    assert file["mechanisms"][2] == {
        "name": "u on x", "kind": "force", "term": "u", "coefficient": 1.0, "std_error": None,
    }  # fmt: skip
    assert from_json(json.dumps(GOOD)).mechanisms == ()


@pytest.mark.parametrize(
    ("field", "value", "parts"),
    [
        ("kind", "magic", ["'magic'", "`mechanisms[1].kind`"]),
        ("coefficient", "1.0", ["`mechanisms[1].coefficient`"]),
        ("coefficient", math.nan, ["JSON"]),
        ("std_error", -1e-9, ["standard error of 'cos(phi)' is negative"]),
        ("surprise", 1, ["`surprise`", "`mechanisms[1]`"]),
    ],
)
def test_what_is_wrong_with_a_mechanism_is_named(field, value, parts):
    file = json.loads(MECHANICAL)
    file["mechanisms"][1][field] = value
    message = refused(file)
    assert all(part in message for part in parts)


@pytest.mark.parametrize("key", msgspec.structs.asdict(MECHANISMS[0]))
def test_a_missing_key_of_a_mechanism_is_named(key):
    file = json.loads(MECHANICAL)
    del file["mechanisms"][3][key]
    assert f"`{key}`" in refused(file)


def test_a_folder_of_results_stands_for_the_model_in_it(tmp_path):
    model = MODELS[next(iter(MODELS))]
    (tmp_path / "model.json").write_text(to_json(model))
    assert to_json(read_model(tmp_path)) == to_json(model)
