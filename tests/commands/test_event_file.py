"""What identify tells a file: whole lines as it goes, the last of which says how it ended."""

import itertools
import json

from cli_cases import STUDY


def lines(path):
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_a_run_is_told_line_by_line(run, tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    ended = run("identify", "study.toml", "--events", "events.jsonl")
    told = lines(tmp_path / "events.jsonl")
    kinds = [line["event"] for line in told]
    assert kinds[-1] == "end"
    assert (told[-1]["code"], ended.code) == (0, 0)
    assert kinds.index("candidates") < kinds.index("equations") < kinds.index("files")
    (candidates,) = [line for line in told if line["event"] == "candidates"]
    assert candidates["target"] == "x_ddot"
    assert sum(point["chosen"] for point in candidates["points"]) == 1
    draft, final = [line for line in told if line["event"] == "equations"]
    assert (draft["draft"], final["draft"]) == (True, False)
    assert final["equations"] == ended.out.splitlines()[:1]
    assert all(one["at"] <= other["at"] for one, other in itertools.pairwise(told))


def test_a_run_that_cannot_begin_says_why(run, tmp_path):
    (tmp_path / "study.toml").write_text(STUDY + "\n[nothing]\n")
    ended = run("identify", "study.toml", "--events", "events.jsonl")
    (end,) = lines(tmp_path / "events.jsonl")
    assert (end["event"], end["code"], ended.code) == ("end", 2, 2)
    assert ended.err == f"odescope: {end['message']}\n"


def test_a_file_that_cannot_be_written_is_told(run, tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    assert "cannot write nowhere" in run.refused("identify", "study.toml", "--events", "nowhere/events.jsonl")
