"""What is said of a model follows from its scores alone."""

import math

import msgspec
import pytest

from odescope.model.choice_notes import TOLD
from odescope.model.notes import notes_of, trust, warnings_of
from odescope.model.scores import (
    Conserved,
    DelayScore,
    Denominator,
    Doubts,
    EnergyScore,
    FormScore,
    FreeRun,
    GatedRange,
    GatedScore,
    HoldScore,
    Likelihood,
    ModelScores,
    PathScore,
    Streamed,
    SuspicionScore,
    TargetScore,
)
from odescope.model.time_score import TimeScore
from odescope.model.worth import FLOWS, share

SOUND = Denominator(data=(0.5, 1.0), box=(0.4, 1.1))
GOOD = TargetScore(0.998, 0.1, 0.997, 12.0, SOUND)
JUDGED = Likelihood(True, 1.02, 0.1, True, 3, None, (), ())
NONE = Doubts(late=False, crowded=False, window=None, thin=())


def said(scores=None, doubts=None, dependent=()):
    return notes_of(scores, dependent, doubts)


def test_a_model_without_scores_is_not_judged():
    assert trust(None) == ()
    assert said() == ()


def test_trust_in_a_sound_model_and_in_one_of_regression_alone():
    sound = ModelScores(targets={"x_dot": GOOD, "y_dot": GOOD}, free_runs=(FreeRun(8.0, 8.0),), likelihood=JUDGED)
    assert trust(sound) == (
        "On held-out data it predicts 99.80 % of the variance of x_dot and 99.80 % of the variance of y_dot (R²).",
        "Run freely from its start, it stays with the recording for all of its 8 s.",
        "No denominator vanishes between the states of the data.",
        "It follows the record to within its noise: residual variance 1.020 times that of the noise.",
    )
    alone = msgspec.structs.replace(sound, likelihood=None)
    assert trust(alone)[-1] == "Its coefficients come from regression alone, so they have no standard errors."


@pytest.mark.parametrize(
    ("box", "poles"),
    [((-0.1, 1.0), True), ((0.0, 1.0), True), ((-math.inf, 1.0), True), ((-2.0, -1.0), False), ((None, 1.0), False)],
)
def test_a_denominator_that_changes_sign_is_a_pole_in_trust_and_notes(box, poles):
    score = msgspec.structs.replace(GOOD, denominator=Denominator((0.5, 1.0), box))
    scores = ModelScores(targets={"x_dot": score})
    assert any(line == "Expect poles in x_dot." for line in trust(scores)) is poles
    assert any("the denominator of x_dot vanishes" in note for note in said(scores)) is poles


def test_what_happened_to_the_data_is_said_in_the_order_of_the_stages():
    scores = ModelScores(
        targets={"x_dot": GOOD},
        left_out=2,
        outliers={"x": 4, "y": 0},
        delays={"u": DelayScore(0.0234, 1e-4), "v": DelayScore(0.0), "w": DelayScore(-0.5, None)},
        streamed=Streamed(120_000, 12, 4),
    )
    notes = said(scores)
    assert [note.split()[0] for note in notes] == ["2", "120,000", "u", "w", "4"]
    assert notes[2] == "u acts 0.0234 s after it was recorded (standard error 0.0001 s)"
    assert notes[3] == "w acts 0.5 s before it was recorded"


@pytest.mark.parametrize(
    ("gain", "line"),
    [
        (412.4, "u is held between samples: 412 in log-likelihood over linear"),
        (2.4, "u is held between samples: 2 in log-likelihood over linear"),
        (
            1.42,
            "u is held between samples: 1.4 in log-likelihood over linear, by which the record hardly decides",
        ),
        (
            -3.0,
            "u is held between samples, or runs linearly and acts half a sample later: the record does not decide",
        ),
        (None, "u is held between samples"),
    ],
)
def test_a_hold_is_told_with_what_speaks_for_it(gain, line):
    assert said(ModelScores(holds={"u": HoldScore("zero", gain)})) == (line,)


def test_holds_that_hardly_differ_are_not_told_and_those_in_doubt_are():
    assert said(ModelScores(holds={"u": HoldScore("band-limited", 4.0)})) == ()
    assert said(ModelScores(holds={"u": HoldScore("band-limited", 6.0)})) != ()
    (line,) = said(ModelScores(holds={"u": HoldScore("linear", None, other="band-limited")}))
    assert line.startswith("u is linear between samples, or band-limited: the record does not decide")


def test_steps_between_samples_are_counted():
    (line,) = said(ModelScores(holds={"u": HoldScore("zero", None, 7)}))
    assert line == "u is held between samples; 7 of its steps fall between two samples, at times that were found"


def test_samples_that_do_not_count_are_told_with_reason_and_time():
    saturated = GatedScore("saturated", 20, (GatedRange(1, 1.25, 1.5, 12), GatedRange(1, 3.0, 3.25, 8)), 0)
    (line,) = said(ModelScores(outliers={"x": 20}, gated={"x": (saturated,)}))
    assert line == "20 samples of x do not count: 20 are saturated (1.25 to 1.5 s, 3 to 3.25 s)"
    late = GatedScore("late", 1, (GatedRange(2, 0.125, 0.125, 1),), 0)
    many = GatedScore("outlier", 9, (GatedRange(1, 1.0, 2.0, 4), GatedRange(3, 5.0, 6.0, 3)), 2)
    (line,) = said(ModelScores(outliers={"x": 10}, gated={"x": (late, many)}))
    assert line == (
        "10 samples of x do not count: 1 was read late (0.125 s of recording 2) and 9 are outliers (1 to 2 s of"
        " recording 1, 5 to 6 s of recording 3, 2 more ranges)"
    )


def test_doubts_of_the_likelihood_are_told_with_its_scores_and_never_without():
    doubts = Doubts(late=False, crowded=True, window=0.2, thin=(("x*y", "y_dot", 2.345),))
    judged = msgspec.structs.replace(JUDGED, finished=False, process_noise={"x_dot": 0.5}, hints=("look",))
    notes = said(ModelScores(likelihood=judged), doubts)
    assert [any(part in note for note in notes) for part in ("its budget", "largest number of terms")] == [True, True]
    assert "0.5 of x_dot unexplained (root mean square of averages over 0.2 s)" in notes[2]
    of_it = msgspec.structs.replace(doubts, units={"x_dot": "mm s⁻¹"})
    small = msgspec.structs.replace(judged, unexplained={"x_dot": 0.0004})  # 0.04 %
    assert not any("unexplained" in n for n in said(ModelScores(likelihood=small), of_it))
    for part, per_cent, warns in ((0.025, "2.50", True), (0.011, "1.10", False)):
        judged = msgspec.structs.replace(judged, unexplained={"x_dot": part})
        (sized,) = (n for n in said(ModelScores(likelihood=judged), of_it) if "unexplained" in n)
        assert f"leaves 0.5 mm s⁻¹ of x_dot ({per_cent} % of its root mean square) unexplained" in sized
        assert sized.endswith("standard errors allow for it")
        assert (sized in warnings_of(ModelScores(likelihood=judged), of_it)) == warns
    judged = msgspec.structs.replace(judged, unexplained={"x_dot": 0.4})
    mostly = said(ModelScores(likelihood=judged), of_it)
    assert "so much of x_dot says that a state was not measured (of two states one of which was measured" in mostly[2]
    assert "the law is one equation with order = 2), what drives it not recorded, or" in mostly[2]
    second = msgspec.structs.replace(judged, process_noise={"x_ddot": 0.5}, unexplained={"x_ddot": 0.4})
    assert (
        "so much of x_ddot says that a state was not measured, what" in said(ModelScores(likelihood=second), of_it)[2]
    )
    assert "an input itself" in mostly[2]
    assert notes[3:] == ("thin evidence, more data would decide: x*y in y_dot (2.3 standard errors)", "look")
    assert said(ModelScores(), doubts) == ()
    late = said(ModelScores(likelihood=judged), msgspec.structs.replace(doubts, late=True))
    assert "ended by the clock" in late[0]


@pytest.mark.parametrize(
    ("doubt", "process_noise", "warns"),
    [
        ({}, None, False),
        ({"thin": (("x*y", "y_dot", 2.3),)}, None, True),
        ({"alike": (("x*y", "y_dot", "x"),)}, None, True),
        ({"crowded": True}, None, True),
        ({"window": 0.2}, {"x_dot": 0.5}, True),
    ],
)
def test_that_the_budget_was_spent_is_no_warning_of_a_model_without_doubts(doubt, process_noise, warns):
    judged = msgspec.structs.replace(JUDGED, finished=False, process_noise=process_noise)
    scores, doubts = ModelScores(likelihood=judged), msgspec.structs.replace(NONE, **doubt)
    (note,) = (n for n in said(scores, doubts) if "ended with its budget" in n)
    assert (note in warnings_of(scores, doubts)) == warns
    assert ("for what it may have missed" in note) == warns
    done = msgspec.structs.replace(scores, likelihood=msgspec.structs.replace(judged, finished=True))
    assert not any("budget" in n for n in said(done, doubts))


def test_what_was_done_is_told_and_what_may_be_wrong_is_a_warning_among_it():
    poles = TargetScore(0.998, 0.1, 0.997, 12.0, Denominator(data=(0.5, 1.0), box=(-0.1, 1.1)))
    tried = {"tried": ("log(x)",), "gain": -3.0, "low": 0.1, "high": 2.0}
    several = {"tried": ("log(x)", "sqrt(x)"), "gain": -7.0}
    scores = ModelScores(
        targets={"x_dot": poles},
        likelihood=JUDGED,
        left_out=2,
        delays={"u": DelayScore(0.02)},
        outliers={"x": 3},
        suspicions=(
            SuspicionScore(target="x_dot", variable="x", reason="powers", terms=2, found=(), **tried),
            SuspicionScore(target="x_dot", variable="y", reason="fractions", terms=2, found=(), **tried),
            SuspicionScore(target="x_dot", variable="z", reason="powers", terms=2, found=(), **tried | {"gain": 6e5}),
            SuspicionScore(target="x_dot", variable="w", reason="powers", terms=2, found=(), **tried | several),
            SuspicionScore(
                target="x_dot",
                variable="v",
                reason="powers",
                terms=2,
                found=(),
                **several | {"gain": float("-inf")},
                low=0.1,
                high=2.0,
            ),
        ),
    )
    doubts = msgspec.structs.replace(NONE, thin=(("x*y", "y_dot", 2.345),))
    told, warned = said(scores, doubts, [("a", ("b",))]), warnings_of(scores, doubts)
    assert set(warned) < set(told)
    for part, warns in {
        "these data cannot tell a from b": False,
        "holds several powers of x": False,
        "powers of z: log(x) was tried, it is not better in the end than the model's own terms": False,
        "powers of w: 2 functions of it were tried, none is better than the model's own terms, the": False,
        "powers of v: 2 functions of it were tried, with none of them can the record be followed": False,
        "holds y in a denominator": False,
        "vanishes between": True,
        "2 recordings are shorter": True,
        "acts 0.02 s after": False,
        "were clipped": False,
        "thin evidence": True,
    }.items():
        assert [part in line for line in told].count(True) == 1, part
        assert any(part in line for line in warned) == warns, part


def test_a_model_that_does_not_follow_has_no_errors_to_speak_of():
    judged = msgspec.structs.replace(JUDGED, follows=False, residual_variance=49.0)
    (note,) = said(ModelScores(likelihood=judged), NONE)
    assert note.startswith("no standard errors: even in short segments the best model misses the record by 7 times")


def test_a_share_is_never_rounded_up_to_the_whole():
    assert [share(v) for v in (0.5, 0.99989, 0.99995, 1.0)] == ["50.00 %", "99.99 %", "more than 99.99 %", "100.00 %"]


# forms, energies and constants


FORMS = (FormScore("lagrangian", 6, 0.0012, 1.01, True, True), FormScore("relations", 12, 0.0034, 1.2, True, False))
SOUND_ENERGY = EnergyScore(0.03, 0.0, 0.01, 0.2)


def test_the_form_that_was_preferred_is_said_with_how_each_did():
    (line,) = said(ModelScores(forms=FORMS))
    assert (
        line == "Lagrange's equations (6 coefficients, free-run error 0.0012) were preferred to relations (12, 0.0034)"
    )
    assert said(ModelScores(forms=FORMS[:1])) == ()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"least_inertia": -0.1}, "kinetic energy is not positive"),
        ({"least_inertia": 0.0}, "kinetic energy is not positive"),
        ({"least_dissipation": -0.2}, "20.00 % of its largest power"),
        ({"imbalance": 0.3}, "30.00 % of the energy"),
        ({"loosest": 1.5}, "record it at another energy"),
    ],
)
def test_energies_are_spoken_of_only_where_something_is_wrong(changed, words):
    assert said(ModelScores(energy=SOUND_ENERGY)) == ()
    assert said(ModelScores(energy=msgspec.structs.replace(SOUND_ENERGY, least_dissipation=-0.0009))) == ()
    (line,) = said(ModelScores(energy=msgspec.structs.replace(SOUND_ENERGY, **changed)))
    assert words in line


ONE_VALUE = (
    "while E + C has one value, several laws say the same, of which the shortest is given: a recording with another"
    " value tells them apart"
)


@pytest.mark.parametrize(
    ("found", "lines"),
    [
        (Conserved("E + C", (0.98,), None), ["E + C stays constant at 0.98 in recording 1", ONE_VALUE]),
        (Conserved("E + C", (0.98, 1.2), None), ["E + C stays constant at 0.98, 1.2 in recordings 1 to 2"]),
        (
            Conserved("E + C", (0.98, 1.2), True),
            ["E + C stays constant at 0.98, 1.2 in recordings 1 to 2, as these reactions have it"],
        ),
        (
            Conserved("E + C", (), True),
            ["these reactions would keep E + C constant, but in the data it is not seen to be"],
        ),
        (
            Conserved("E + C", (), True, 0.02),
            [f"these reactions would keep E + C constant, but in the data it moves: {FLOWS}"],
        ),
        (
            Conserved("E + C", (1.0,), False),
            [
                "E + C stays constant at 1 in recording 1",
                ONE_VALUE,
                "these reactions would change E + C, which the data show constant",
            ],
        ),
    ],
)
def test_sums_that_stay_constant_are_said_in_words(found, lines):
    assert list(said(ModelScores(conserved=(found,)))) == lines


def path_of(count, chosen):
    """Return a path on which step k dropped x**k, which stood k standard errors away from zero."""
    rows = range(count)
    return tuple(
        PathScore(
            20 - k,
            0.01 + 0.001 * k,
            0.002,
            f"x**{k} in potential" if k else None,
            float(k**2) if k else None,
            k == chosen,
        )
        for k in rows
    )


def test_what_the_path_left_out_is_listed_with_its_evidence_the_strongest_first():
    (note,) = said(ModelScores(path=path_of(5, 2)))
    assert note == (
        "left out on the way back from 20 terms to 18, free-run error 0.01 with them, 0.012 without:"
        " x**2 in potential (2 standard errors) and x**1 in potential (1 standard errors);"
        " [likelihood] terms = 20 keeps them"
    )
    (note,) = said(ModelScores(path=path_of(12, 10)))
    assert note.count("standard errors") == TOLD
    assert "x**10 in potential (10 standard errors), x**9" in note
    assert note.endswith("x**5 in potential (5 standard errors) and 4 more; [likelihood] terms = 20 keeps them")
    much = msgspec.structs.replace(path_of(2, 1)[1], statistic=1.331e7)
    assert "x**1 in potential (3648 standard errors)" in said(ModelScores(path=(path_of(2, 1)[0], much)))[0]


@pytest.mark.parametrize("path", [(), path_of(1, 0), path_of(5, 0), path_of(5, 9)], ids=["none", "one", "first", "no"])
def test_where_the_choice_is_the_first_model_nothing_was_left_out(path):
    assert said(ModelScores(path=path)) == ()


def test_trust_rests_on_free_runs_over_what_is_held_out():
    (line,) = trust(ModelScores(path=path_of(5, 2)))
    assert line == (
        "Fitted without the held-out stretches and run freely over them, it is 0.012 standard deviations of the record"
        " off (0.002 from stretch to stretch)."
    )
    bare = msgspec.structs.replace(path_of(1, 0)[0], spread=0.0)
    assert trust(ModelScores(path=(bare,)))[0].endswith("of the record off.")
    (line,) = trust(ModelScores(path=(msgspec.structs.replace(bare, error=1.0, spread=6.3e-6),)))
    assert line == "Fitted without the held-out stretches and run freely over them, it loses the record."


def test_rows_at_uneven_times_are_not_told_missing_and_cells_that_are_are():
    missing = {"A": (75, 38), "B": (72, 37), "C": (72, 37)}
    told = said(ModelScores(time=TimeScore(100, 0, 0, 0.0, 172, missing)), NONE)
    assert "samples are not at even times: 100 rows count at the nearest of 172 points of a grid" in told
    assert [n for n in told if "missing" in n] == ["3 samples of A, of 100, are missing (3.00 %)"]


@pytest.mark.parametrize(
    ("cut", "unseen", "split", "at"),
    [
        (1, 0, False, "a gap too long to bridge"),
        (2, 2, False, "2 gaps in which what an input did is not known"),
        (3, 1, False, "2 gaps too long to bridge and at a gap in which what an input did is not known"),
        (3, 0, True, '3 gaps to be split (gaps = "split" in [data])'),
    ],
)
def test_recordings_are_cut_for_reasons_that_apply(cut, unseen, split, at):
    time = TimeScore(100, 0, 0, 0.0, 120, {}, cut=cut, unseen=unseen, split=split)
    assert said(ModelScores(time=time)) == (f"recordings were cut at {at}",)


@pytest.mark.parametrize(
    ("longest", "off", "warned"),
    [(20, 0.04, "u lacks up to 20 samples in a row"), (1, 0.04, "u lacks single samples"), (20, 0.002, "")],
)
def test_inputs_that_moved_in_their_gaps_are_warned_of(longest, off, warned):
    time = TimeScore(100, 0, 0, 0.0, 120, {"x": (20, 1)}, {"u": (longest, off)})
    told = [n for n in warnings_of(ModelScores(time=time), NONE) if n.startswith("u lacks")]
    assert len(told) == bool(warned)
    assert all(n.startswith(f"{warned}, over which") and 'gaps = "split"' in n and "4.00 %" in n for n in told)


@pytest.mark.parametrize(
    ("stays", "gap", "process_noise", "told"),
    [
        (False, 0.001, None, True),
        (True, 0.001, None, False),
        (False, 1.0, None, False),
        (False, None, {"x": 0.1}, False),
    ],
)
def test_a_free_run_that_parts_from_a_record_which_the_model_follows_is_explained(stays, gap, process_noise, told):
    runs = (FreeRun(10.0, 10.0), FreeRun(10.0, 10.0 if stays else 0.25, recording=2))
    judged = msgspec.structs.replace(JUDGED, gap=gap, process_noise=process_noise)
    notes = notes_of(ModelScores(likelihood=judged, free_runs=runs), (), None)
    assert any("parts from it after 0.25 s" in note for note in notes) == told
