import sys

import pytest
from hand_models import MODELS

import odescope
from odescope.errors import InputError
from odescope.export import languages


@pytest.mark.parametrize("language", languages.names())
def test_every_language_has_a_public_name(language):
    assert languages.writer(language) is getattr(odescope, f"to_{language}")


def test_a_file_is_all_that_a_language_takes(tmp_path, monkeypatch):
    (tmp_path / "shouted.py").write_text("def write(model):\n    return ' '.join(model.states).upper()\n")
    monkeypatch.setattr(languages, "__path__", [*languages.__path__, str(tmp_path)])
    assert languages.names() == ("latex", "mathml", "python", "shouted", "text")
    assert languages.writer("shouted")(MODELS["coupled"]) == "C Q W Q_DOT W_DOT W_DDOT"
    del sys.modules["odescope.export.languages.shouted"]


def test_an_unknown_language_is_named_with_the_nearest():
    with pytest.raises(InputError, match=r"cannot export to 'pyton'.*python"):
        languages.writer("pyton")
