"""The demo's report as a browser shows it: nothing cut off, nothing fetched, nothing complained of, and it prints."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from logs import Command
from PIL import Image

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
MEASURE = """<script>
addEventListener("load", () => {
  const wide = document.documentElement.clientWidth, cut = [];
  for (const e of document.body.querySelectorAll("*")) {
    if (e.closest("svg") || e.closest("math")) continue;
    const box = e.getBoundingClientRect(), holder = e.parentElement.closest(".scroll, .equation");
    if (box.right > wide + 1 && !holder) cut.push(e.tagName + "." + e.className + " " + e.textContent.slice(0, 40));
    const hidden = getComputedStyle(e).overflowX === "visible" ? 0 : e.scrollWidth - e.clientWidth;
    if (hidden > 1 && !e.matches(".scroll, .equation, .scroll *, .equation *")) cut.push("hidden " + e.tagName);
  }
  const math = [...document.querySelectorAll("math")].map(m => m.getBoundingClientRect().height);
  const pictures = [...document.querySelectorAll("figure svg")].map(s => s.getBoundingClientRect().width);
  parent.postMessage({inner: innerWidth, scroll: document.documentElement.scrollWidth, cut, math, pictures}, "*");
});
</script>"""
FRAME = """<!doctype html><body style="margin:0"><iframe width="{width}" height="900" src="copy.html"></iframe><script>
addEventListener("message", m => {{ document.title = "measured"; document.body.append(JSON.stringify(m.data)); }});
</script>"""

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")


def chromium(folder, *options):
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
        "--disable-component-update", "--hide-scrollbars", "--enable-logging=stderr", "--v=0",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={folder / 'profile'}", *options,
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Write the demo's results, figures and all, and return their folder."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        from odescope.commands import cli

        patch.setattr("sys.argv", ["odescope", "demo", "--out", str(folder)])
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert not end.value.code
    return folder


def complaints(ended):
    return [line for line in ended.stderr.splitlines() if "CONSOLE" in line or "ERR_" in line]


@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_is_cut_off_and_the_console_is_silent(demo, tmp_path, width):
    page = (demo / "report.html").read_text(encoding="utf-8")
    (tmp_path / "copy.html").write_text(page.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    (tmp_path / "frame.html").write_text(FRAME.format(width=width))
    ended = chromium(tmp_path, "--virtual-time-budget=8000", "--dump-dom", (tmp_path / "frame.html").as_uri())
    assert complaints(ended) == []
    found = json.loads(html.unescape(re.search(r"\{.*\}", ended.stdout.partition("</script>")[2])[0]))
    assert found["inner"] == width
    assert found["scroll"] <= width
    assert found["cut"] == []
    assert max(found["math"]) > 45.0  # a fraction is typeset: it is taller than its lines
    assert len(found["pictures"]) == 11
    assert min(found["pictures"]) > 600.0  # on a phone figures scroll and stay legible


def test_the_measuring_does_see_what_is_cut_off(tmp_path):
    """A test of the test: a page that is too wide is told."""
    wide = '<!doctype html><body><p style="width:900px">too wide</p>'
    (tmp_path / "copy.html").write_text(wide + "<script>nothing.there()</script>" + MEASURE)
    (tmp_path / "frame.html").write_text(FRAME.format(width=400))
    ended = chromium(tmp_path, "--virtual-time-budget=2000", "--dump-dom", (tmp_path / "frame.html").as_uri())
    assert '"cut":["P. too wide"]' in html.unescape(ended.stdout)
    assert len(complaints(ended)) == 1


@pytest.mark.slow
def test_it_prints_to_several_pages(demo, tmp_path):
    ended = chromium(tmp_path, f"--print-to-pdf={tmp_path / 'r.pdf'}", (demo / "report.html").as_uri())
    assert complaints(ended) == []
    pdf = (tmp_path / "r.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert 8 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 40


def test_the_demos_files(demo):
    page = (demo / "report.html").read_text(encoding="utf-8")
    assert len(page) < 1_500_000
    assert "Table 2" in page
    names = sorted(p.name for p in (demo / "figures").iterdir())
    assert len(names) == 22
    for name in names:
        path = demo / "figures" / name
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert image.size[0] == 936
                assert len(image.convert("L").getcolors(256)) > 10  # something is drawn
        else:
            assert path.read_text(encoding="utf-8").startswith("<?xml")


@pytest.mark.slow
def test_drawing_it_again_gives_the_same_bytes(demo, tmp_path, monkeypatch, capsys):
    odescope = Command(monkeypatch, capsys, drawing=True)
    assert odescope("report", demo, "--out", tmp_path / "again").code == 0
    assert (tmp_path / "again" / "report.html").read_bytes() == (demo / "report.html").read_bytes()
    for path in (demo / "figures").iterdir():
        assert (tmp_path / "again" / "figures" / path.name).read_bytes() == path.read_bytes()
    assert sorted(p.name for p in (tmp_path / "again").iterdir()) == ["figures", "report.html"]


def test_a_folder_without_a_report_is_told_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    odescope = Command(monkeypatch, capsys)
    assert "odescope identify writes it" in odescope.refused("report", ".")
    Path("report.json").write_text("[]")
    assert "is not a report" in odescope.refused("report", ".")
