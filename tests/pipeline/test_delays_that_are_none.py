"""Whether a study is run once more with the delays of its inputs looked for before regression."""

from types import SimpleNamespace

import pytest

from odescope.errors import NoModelError
from odescope.events import DelaysEstimated, Monitor, Note
from odescope.pipeline.late_inputs import with_late_inputs
from odescope.study.options import Data, Driven, Measured, Study

STUDY = Study(data=Data(time="t"), coordinates={"x": Measured(order=1)}, inputs={"u": Driven()})


@pytest.mark.parametrize(("delay", "found"), [(0.0, False), (0.5, True)])
def test_nothing_is_searched_again_where_no_input_turns_out_late(delay, found):
    searched = []

    def run(study, monitor):
        if study.inputs["u"].delay == "estimate":
            monitor.tell(DelaysEstimated({"u": delay}))
        searched.append(study.inputs["u"].delay)
        if study.inputs["u"].delay == "auto":
            raise NoModelError("likelihood", "nothing at hand is a law")
        return "law", SimpleNamespace(exact=True)

    if found:
        assert with_late_inputs(STUDY, Monitor(), run, Note)[0] == "law"
        assert searched == ["auto", "estimate"]
        return
    with pytest.raises(NoModelError, match="nothing at hand"):
        with_late_inputs(STUDY, Monitor(), run, Note)
    assert searched == ["auto"]
