"""The workbench in a browser: from a log to an exported model, and everything that may come between."""

import http.client
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing

import psutil
import pytest

pytest.importorskip("nicegui")
pytest.importorskip("playwright")

from workbench_cases import AXE, CHROMIUM, PATIENCE, Visit, browser, chain, decay, heater, served, shaken

from odescope.export.model_file import write_model

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")

SLOW = '[data]\nfiles = ["a.csv"]\ntime = "t"\n[coordinates]\np.order = 2\nq.order = 2\nr.order = 2\n'
VIEWS = ("data", "study", "run", "look", "try", "take")


@pytest.fixture(scope="module")
def chromium():
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def workbench(tmp_path_factory):
    """A workbench on a folder that holds a result of the command line, and room for more."""
    folder = tmp_path_factory.mktemp("logs")
    (folder / "known").mkdir()
    options = ["--time", "t", "--coordinate", "a", "--coordinate", "b"]
    command = [sys.executable, "-m", "odescope", "identify", chain(folder / "known" / "ab.csv"), *options]
    subprocess.run(command, check=True, capture_output=True)
    (folder / "known" / "ab.toml").write_text('[data]\nfiles = ["ab.csv"]\ntime = "t"\n[coordinates]\na = {}\nb = {}\n')
    with served(folder, tmp_path_factory.mktemp("log") / "log.txt") as one:
        yield one


def place(workbench, name):
    """A folder in that of the workbench, with a log."""
    made = workbench.folder / name
    made.mkdir()
    decay(made / "a.csv")
    return made


@pytest.mark.slow
def test_from_a_log_to_an_exported_model_by_clicks_alone(chromium, workbench):
    folder, visit = place(workbench, "clicks"), Visit(chromium, workbench)
    page = visit.page
    page.get_by_role("link", name="clicks/a.csv").click()
    page.get_by_role("heading", name="clicks/a.csv", level=1).wait_for()
    visit.says("an amount? order 2 for a position")
    page.get_by_role("button", name="Make a study of it").click()
    visit.says("valid and saved")
    assert (folder / "a.toml").read_text().startswith("# Drafted from a look")
    page.get_by_role("button", name="Identify").click()
    page.get_by_text("running").first.wait_for()
    page.reload()  # in the middle of the run
    visit.says("c_dot = ")
    page.get_by_role("button", name="Look at the result").click()
    page.locator("math").first.wait_for()
    visit.says("measured − free run")
    page.get_by_role("link", name="Take it away").click()
    page.get_by_text("def derivative").wait_for()
    result = folder / "a"
    offered = {link.get_attribute("href") for link in page.locator("a[href^='/stored/']").all()}
    assert offered == {f"/stored/clicks/a/{f.relative_to(result)}" for f in result.rglob("*") if f.is_file()}
    page.get_by_role("button", name="Write into the folder").click()
    visit.says("wrote clicks/a/exports/python/")
    written = (folder / "a" / "exports" / "python" / "model.py").read_text()
    by_command = [sys.executable, "-m", "odescope", "export", str(folder / "a"), "--to", "python"]
    assert written == subprocess.run(by_command, check=True, capture_output=True, text=True).stdout
    assert visit.wrong == []


@pytest.mark.slow
def test_several_logs_are_one_study_by_keys_and_clicks_as_of_the_command_line(chromium, workbench):
    folder, visit = place(workbench, "several"), Visit(chromium, workbench, 400)
    for name in ("b.csv", "c.csv"):
        decay(folder / name, seed=ord(name[0]))
    decay(folder / "d.csv", "another")
    visit.go("/data?name=several/b.csv", "several/b.csv")
    page = visit.page
    visit.says("other logs here have these columns")
    page.get_by_role("button", name="Make a study of it").wait_for()
    assert page.get_by_role("checkbox", name="several/d.csv").count() == 0
    for name in ("several/a.csv", "several/c.csv"):
        page.get_by_role("checkbox", name=name, exact=True).press("Space")
    visit.says("3 logs: 600 samples in 3 recordings")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    page.get_by_role("button", name="Make a study of them").click()
    visit.says("valid and saved")
    page.get_by_role("heading", name="several/a-and-2-more.toml", level=1).wait_for()
    names = [str(folder / name) for name in ("a.csv", "b.csv", "c.csv")]
    command = [sys.executable, "-m", "odescope", "init", *names, "--out", str(folder / "by_command.toml")]
    subprocess.run(command, check=True, capture_output=True)
    assert (folder / "a-and-2-more.toml").read_text() == (folder / "by_command.toml").read_text()
    assert visit.wrong == []


@pytest.mark.slow
def test_a_run_whose_result_was_replaced_leads_to_the_one_that_did(chromium, workbench):
    folder = place(workbench, "again")
    (folder / "a.toml").write_text('[data]\nfiles = ["a.csv"]\ntime = "t"\n[coordinates.c]\n')
    visit = Visit(chromium, workbench, 400)
    page, first = visit.page, visit.tab()
    names = []
    for tab in (first, page):
        tab.goto(visit.base + "/study?name=again/a.toml")
        tab.get_by_role("button", name="Identify").click()
        tab.get_by_role("button", name="Look at the result").wait_for()
        names.append(tab.get_by_role("heading", level=1).inner_text())
    first.get_by_role("button", name="Look at the result").click()  # of a page that knows nothing of the second run
    first.get_by_text("done; its result was replaced by the run of").wait_for()
    assert first.get_by_role("button", name="Look at the result").count() == 0
    assert first.get_by_role("link", name="Open the report").count() == 0
    assert first.get_by_role("link", name=f"{names[0]} replaced").count() == 1
    assert first.evaluate("document.documentElement.scrollWidth") <= 400
    first.get_by_role("link", name="Open the run that replaced its result").click()
    first.get_by_role("heading", level=1, name=names[1], exact=True).wait_for()
    first.get_by_role("button", name="Look at the result").click()
    first.locator("math").first.wait_for()
    assert visit.wrong == []


@pytest.mark.slow
def test_the_study_is_the_same_as_form_and_as_text_in_two_tabs(chromium, workbench):
    folder = place(workbench, "tabs")
    (folder / "a.toml").write_text('# mine\n[data]\nfiles = ["a.csv"]\ntime = "t"\n[coordinates.c]\n')
    visit = Visit(chromium, workbench)
    visit.go("/study?name=tabs/a.toml", "tabs/a.toml")
    visit.says("valid and saved")
    other = visit.tab()
    other.goto(visit.base + "/study?name=tabs/a.toml")
    text = visit.page.get_by_role("textbox", name="the study as text")
    visit.page.get_by_role("textbox", name="unit", exact=True).fill("mol/l")
    visit.page.wait_for_function("""() => document.querySelector("textarea").value.includes('unit = "mol/l"')""")
    expected = '# mine\n[data]\nfiles = ["a.csv"]\ntime = "t"\n[coordinates.c]\nunit = "mol/l"\n'
    other.wait_for_function("""() => document.querySelector("textarea").value.includes('unit = "mol/l"')""")
    assert (folder / "a.toml").read_text() == expected
    text.fill(expected.replace("mol/l", "g/l") + "ordre = 1\n")
    visit.says("unknown key 'ordre' in [coordinates.c]; did you mean 'order'?")
    assert visit.page.get_by_role("button", name="Identify").is_disabled()
    assert (folder / "a.toml").read_text() == expected
    text.fill(expected.replace("mol/l", "g/l"))
    visit.says("valid and saved")
    assert visit.page.get_by_role("textbox", name="unit", exact=True).input_value() == "g/l"
    other.wait_for_function("""() => document.querySelector("textarea").value.includes('unit = "g/l"')""")
    (folder / "a.toml").write_text(expected)  # by an editor
    visit.page.wait_for_function("""() => document.querySelector("textarea").value.includes('unit = "mol/l"')""")
    assert visit.wrong == []


@pytest.mark.slow
def test_a_run_outlives_its_server_and_is_stopped_by_keys_alone(chromium, tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    shaken(folder / "a.csv")
    (folder / "a.toml").write_text(SLOW)
    with served(folder, tmp_path / "first.txt") as first:
        visit = Visit(chromium, first)
        visit.go("/study", "a.toml")
        visit.says("valid and saved")
        press_until(visit.page, "Identify")
        visit.says("● running")
        (record,) = folder.glob(".odescope/*/run.json")
        run = psutil.Process(json.loads(record.read_text())["pid"])
        first.process.kill()
        first.process.wait()
    assert run.is_running()
    with served(folder, tmp_path / "second.txt") as second:
        visit = Visit(chromium, second)
        visit.go("/run", record.parent.name)
        visit.says("● running")
        begun = time.monotonic()
        press_until(visit.page, "Stop")
        visit.says("■ stopped")
        assert time.monotonic() - begun < 10.0  # pressing the keys included
        assert not run.is_running() or run.status() == psutil.STATUS_ZOMBIE
        until = time.monotonic() + 10.0
        while (left := sorted(p.name for p in folder.iterdir())) != [".odescope", "a.csv", "a.toml"]:
            assert time.monotonic() < until, left
            time.sleep(0.1)
        assert visit.wrong == []
        second.process.send_signal(signal.SIGINT)
        assert second.process.wait(20) in (0, 130)
    assert (tmp_path / "second.txt").read_text().count("Traceback") == 0


@pytest.mark.slow
def test_a_page_finds_the_workbench_again_that_was_killed_once_its_address_is_opened(chromium, tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    decay(folder / "a.csv")
    with served(folder, tmp_path / "first.txt") as first:
        visit = Visit(chromium, first)
        visit.page.get_by_role("button", name="Make a study of it").wait_for()
        visit.page.evaluate("window.before = true")
    visit.says("Connection lost")
    with served(folder, tmp_path / "second.txt") as second, served(folder, tmp_path / "third.txt") as third:
        assert second.base == first.base
        assert second.address != first.address
        assert third.port != second.port
        old = first.address.partition("token=")[2]
        refused = request(second, "/data", Host=f"127.0.0.1:{second.port}", Cookie=f"odescope-{second.port}={old}")
        assert refused[0] == 403
        visit.tab().goto(second.address)
        visit.page.wait_for_function("window.before === undefined && document.body.innerText.includes('a.csv')")
        visit.page.get_by_role("button", name="Make a study of it").click()
        visit.says("valid and saved")


def press_until(page, label):
    """Go from control to control by the tabulator to the button of a label, and press it by Enter."""
    page.wait_for_function("window.did_handshake")  # until then the page drops what is pressed
    page.evaluate("document.activeElement.blur()")
    for _ in range(80):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.innerText || ''").strip() == label:
            page.keyboard.press("Enter")
            return
    raise AssertionError(f"no way by keys to {label}")


def test_hostile_names_are_text(chromium, workbench):
    folder = place(workbench, "hostile")
    attack = "<img src=x onerror=alert(1)>{{7*7}}"
    decay(folder / "<b onmouseover=alert(2)>x<'b>.csv", attack)
    visit = Visit(chromium, workbench)
    visit.page.get_by_role("link", name="hostile/<b onmouseover=alert(2)>x<'b>.csv").click()
    visit.page.get_by_role("heading", name="hostile/<b onmouseover=alert(2)>x<'b>.csv", level=1).wait_for()
    visit.page.get_by_role("cell", name=attack).wait_for()
    visit.page.mouse.move(700, 300)  # where a tooltip names the line
    visit.page.get_by_role("button", name="Make a study of it").click()
    visit.says("valid and saved")
    visit.page.get_by_text(attack, exact=True).wait_for()
    assert visit.page.locator("img").count() == 0
    assert "49" not in visit.page.inner_text(".form")
    assert visit.wrong == []


def request(workbench, path, **headers):
    """Return the status and the headers of what is answered."""
    with closing(http.client.HTTPConnection("127.0.0.1", workbench.port, timeout=20)) as connection:
        connection.putrequest("GET", path, skip_host=True)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        with connection.getresponse() as answer:
            return answer.status, answer.headers


def test_only_who_has_the_token_is_served_and_nothing_outside(chromium, workbench):
    folder = workbench.folder
    (folder.parent / "secret.csv").write_text("t,x\n0,1\n")
    (folder / "r").mkdir()
    (folder / "r" / "model.json").write_text("{}")
    (folder / "r" / "link.csv").symlink_to(folder.parent / "secret.csv")
    token = workbench.address.partition("token=")[2]
    host, cookie = f"127.0.0.1:{workbench.port}", f"odescope-{workbench.port}={token}"
    assert request(workbench, "/data", Host=host)[0] == 403
    assert request(workbench, "/data", Host=host, Cookie=cookie)[0] == 200
    assert request(workbench, "/data", Host="evil.example", Cookie=cookie)[0] == 403
    assert request(workbench, "/data", Host=host, Cookie=cookie, Origin="http://evil.example")[0] == 403
    status, found = request(workbench, "/stored/r/model.json", Host=host, Cookie=cookie)
    assert status == 200
    assert found["content-security-policy"].startswith("sandbox")
    outside = ("../secret.csv", "r/../../secret.csv", "r/link.csv", "%2e%2e/secret.csv", "..%2fsecret.csv")
    for path in (*outside, "known/ab.csv"):
        assert request(workbench, f"/stored/{path}", Host=host, Cookie=cookie)[0] == 404, path
    for origin, status in (("http://evil.example", b"403"), (f"http://{host}", b"101")):
        ask = (
            f"GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n"
            f"Cookie: {cookie}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        with socket.create_connection(("127.0.0.1", workbench.port), timeout=20) as raw:
            raw.sendall(ask.encode())
            assert raw.recv(64).split()[1] == status
    visit = Visit(chromium, workbench)
    for view in ("data", "study", "look"):
        visit.go(f"/{view}?name=../secret.csv")
        visit.page.get_by_role("alert").wait_for()
        assert "no path within" in visit.page.get_by_role("alert").inner_text()


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 400])
def test_every_view_is_whole_and_said_to_a_screen_reader(chromium, workbench, width):
    visit = Visit(chromium, workbench, width)
    for view in VIEWS:
        visit.go(
            f"/{view}"
            + {"data": "?name=known/ab.csv", "study": "?name=known/ab.toml", "run": ""}.get(view, "?name=known/ab")
        )
        visit.page.get_by_role("heading", level=1).wait_for()
        if view in ("data", "look", "try"):
            visit.page.locator(".chart canvas").first.wait_for()
        visit.page.evaluate("document.querySelectorAll('[aria-expanded=false][role=button]').forEach(e => e.click())")
        visit.page.wait_for_timeout(700)  # what opens does so gently
        assert visit.page.evaluate("document.documentElement.scrollWidth") <= width, view
        if AXE.is_file():
            visit.page.evaluate(AXE.read_text(encoding="utf-8"))
            found = visit.page.evaluate("axe.run()")["violations"]
            grave = [v for v in found if v["impact"] in ("serious", "critical")]
            assert not grave, [(view, v["id"], [n["html"] for n in v["nodes"]]) for v in grave]
    assert visit.wrong == []


@pytest.mark.slow
def test_a_result_of_the_command_line_is_looked_at_tried_and_validated(chromium, workbench):
    visit = Visit(chromium, workbench)
    page = visit.page
    visit.go("/look?name=known/ab", "known/ab")
    visit.says("From many terms to few")
    slider = page.get_by_role("slider", name="model on the path, from many terms to few")
    slider = slider.locator("[tabindex]")
    slider.focus()
    slider.press("ArrowRight")
    page.wait_for_function("""() => /\\d+ terms/.test(document.querySelectorAll(".reading")[0].innerText)""")
    at = page.get_by_role("slider", name="time at which the lines are read")
    at = at.locator("[tabindex]")
    at.focus()
    at.press("ArrowRight")
    page.wait_for_function("""() => document.querySelectorAll(".reading")[1].innerText.startsWith("0.01495 s")""")
    visit.go("/try?name=known/ab", "known/ab")
    assert page.get_by_label("duration (s)").input_value() == "15"
    at_start = page.get_by_role("slider", name="a at the start").locator("xpath=../span[@class='reading']")
    assert 1.98 < float(at_start.inner_text()) < 2.02  # where the record begins
    page.get_by_role("button", name=re.compile("Validate|Compare")).click()
    visit.says("many starts")
    start = page.get_by_role("slider", name=re.compile("at the start")).first.locator("[tabindex]")
    start.focus()
    for _ in range(4):
        page.locator("canvas").first.wait_for()
        start.press("PageUp")
    visit.says("outside the data of the model")
    page.get_by_label("duration (s)").fill("-1")
    visit.says("the duration must be a positive number")
    assert visit.wrong == []
    with page.expect_popup() as report:
        visit.go("/look?name=known/ab", "known/ab")
        page.get_by_role("link", name="Open the report").click()
    report.value.get_by_role("heading", name="How to reproduce").wait_for(timeout=PATIENCE)


@pytest.mark.slow
def test_a_path_of_two_models_is_said_in_words(chromium, workbench):
    for name, left in (("whole", 3), ("few", 2)):
        result = place(workbench, name) / "ab"
        shutil.copytree(workbench.folder / "known" / "ab", result)
        shutil.copy(workbench.folder / "known" / "ab.csv", result.parent)
        paths = sorted((result / "path").iterdir())
        for path in paths[1 : len(paths) - left + 1]:
            path.unlink()
        visit = Visit(chromium, workbench)
        visit.go(f"/look?name={name}/ab", f"{name}/ab")
        visit.says("measured − free run")
        visit.says(re.compile("the result itself; error 0.00[0-9]+ standard deviations"))
        visit.page.get_by_role("slider", name="model on the path").wait_for()
        assert visit.page.get_by_role("img", name="error over number of terms").count() == left - 2
        assert visit.wrong == []


@pytest.mark.slow
def test_a_model_is_tried_from_one_level_to_another_within_its_data(chromium, workbench):
    folder = place(workbench, "try")
    (folder / "heater").mkdir()
    write_model(heater(), folder / "heater" / "model.json")
    visit = Visit(chromium, workbench, 400)
    page = visit.page
    visit.go("/try?name=try/heater", "try/heater")
    page.get_by_role("group", name="u (V)").wait_for()
    shown = {"level (V)": "10", "steps to (V)": "10.5", "begins at (s)": "1", "duration (s)": "10"}
    assert {label: page.get_by_label(label).input_value() for label in shown} == shown
    assert not page.get_by_label("frequency (Hz)", exact=True).is_visible()
    page.get_by_role("slider", name="T (K) at the start").wait_for()
    page.get_by_label("steps to (V)").fill("90")
    visit.says("outside the data of the model")
    page.get_by_role("combobox", name="shape").click()
    page.get_by_role("option", name="chirp").click()
    for label in ("amplitude (V)", "frequency (Hz)", "last frequency (Hz)"):
        page.get_by_label(label, exact=True).wait_for()
    assert not page.get_by_label("steps to (V)").is_visible()
    page.get_by_text("outside the data of the model").wait_for(state="detached")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    assert visit.wrong == []
