"""What an identification tells while it works, and how it is stopped."""

import pytest
from logs import oscillator
from msgspec import structs

from odescope.errors import Stopped
from odescope.events import Event, Note, StageBegan
from odescope.pipeline.identification import DraftReady, EquationsReady, identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

STUDY = Study(
    data=Data(time="t"),
    coordinates={"x": Measured(order=2)},
    inputs={"u": Driven()},
    library=Candidates(
        terms=("1", "sin(x)**2", "cos(x)**2", "x", "x_dot", "u", "x_ddot")
    ),  # a note tells of one too many
)
STAGES = ["records", "library", "signals", "regression", "selection", "model", "bootstrap", "likelihood", "model"]


@pytest.fixture(scope="module")
def told():
    events = list[Event]()
    return identify(STUDY, oscillator(), watch=events.append), events


def place(events, kind):
    return next(k for k, event in enumerate(events) if isinstance(event, kind))


def test_events_come_in_the_order_of_the_work(told):
    result, events = told
    draft, ready = place(events, DraftReady), place(events, EquationsReady)
    before = [e.stage for e in events[:draft] if isinstance(e, StageBegan)]
    assert list(dict.fromkeys(before)) == STAGES[:-2]
    assert events[draft + 1] == StageBegan("likelihood")
    assert events[ready - 1] == StageBegan("model")
    assert events[ready].result is result
    assert events[ready + 1 :] == [Note(note, note in result.warnings) for note in result.notes] != []


def test_the_draft_is_the_result_of_the_regression(told):
    result, events = told
    draft = events[place(events, DraftReady)].result
    assert draft.refinement is None
    assert [s.problem for s in draft.searches] == [s.problem for s in result.searches]
    assert draft.model.scores is None
    assert draft.notes
    assert "<math" in draft._repr_html_()
    assert [t.text for t in draft.model.relations[0].terms] == [t.text for t in result.model.relations[0].terms]
    assert all(t.std_error is None for t in draft.model.relations[0].terms)


@pytest.mark.parametrize("stage", [*STAGES[:-1], DraftReady])
def test_a_token_that_fires_at_an_event_ends_the_run_before_the_next_stage(stage):
    events, asked = list[Event](), []

    def fired():
        return any(e == StageBegan(stage) if isinstance(stage, str) else isinstance(e, stage) for e in events)

    def stop():
        asked.append(len(events))
        return fired()

    with pytest.raises(Stopped):
        identify(STUDY, oscillator(), watch=events.append, stop=stop)
    assert fired()
    assert not any(isinstance(e, EquationsReady) for e in events)
    stages = [e.stage for e in events if isinstance(e, StageBegan)]
    assert stages[-1] == (stage if isinstance(stage, str) else "bootstrap")
    assert asked[-1] == len(events)  # nothing was told after the answer


@pytest.mark.parametrize("stage", ["delays", "regression", "bootstrap"])
def test_a_long_stage_asks_on_the_way(stage):
    delay = "estimate" if stage == "delays" else 0.0
    study = structs.replace(STUDY, inputs={"u": Driven(delay=delay)})
    events, asked = list[Event](), []

    def stop():
        asked.extend([None] * (events[-1:] == [StageBegan(stage)]))
        return len(asked) > 5

    with pytest.raises(Stopped):
        identify(study, oscillator(), watch=events.append, stop=stop)
    assert events[-1] == StageBegan(stage)


def test_what_a_listener_raises_ends_the_run():
    def watch(event):
        if event == StageBegan("selection"):
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        identify(STUDY, oscillator(), watch=watch)


@pytest.mark.parametrize("cause", [KeyboardInterrupt, ValueError])
def test_an_interrupt_that_came_while_compiled_code_returned_is_one(cause):
    def watch(event):
        if event == StageBegan("likelihood"):
            within = SystemError("an inner function returned a result with an exception set")
            within.__cause__ = cause()
            raise SystemError("a function returned a result with an exception set") from within

    with pytest.raises(KeyboardInterrupt if cause is KeyboardInterrupt else SystemError):
        identify(STUDY, oscillator(), watch=watch)
