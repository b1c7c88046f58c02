"""Who may talk to the app: each refusal by itself, and over a real connection."""

import http.client
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from app_browser import serve, stop
from workbench.app.security import HEADERS, Gate, new_token, resolve_inside

GATE = Gate("right", 5000)
HOST = {"Host": "127.0.0.1:5000"}


def test_tokens_are_random_and_long():
    tokens = {new_token() for _ in range(50)}
    assert len(tokens) == 50 and min(map(len, tokens)) >= 43


def test_the_right_token_on_the_own_host_is_allowed():
    assert GATE.check(HOST, {"token": "right"}, {}, False) is None
    assert GATE.check({"Host": "localhost:5000"}, {}, {GATE.cookie: "right"}, False) is None


@pytest.mark.parametrize("token", ["", "wrong", "Right", "right ", "righ", "ä"])
def test_a_wrong_token_is_refused(token):
    assert "token" in GATE.check(HOST, {"token": token}, {}, False)
    assert "token" in GATE.check(HOST, {}, {GATE.cookie: token}, False)


def test_the_cookie_of_an_app_at_another_port_is_refused():
    assert "token" in GATE.check(HOST, {}, {"workbench-5001": "right"}, False)


@pytest.mark.parametrize(
    "host",
    [
        "",
        "127.0.0.1",
        "127.0.0.1:80",
        "evil.example:5000",
        "127.0.0.1:5000.evil.example",
        "[::1]:5000",
    ],
)
def test_a_foreign_host_is_refused(host):
    assert "Host" in GATE.check({"Host": host}, {"token": "right"}, {}, False)


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "http://evil.example",
        "https://127.0.0.1:5000",
        "http://127.0.0.1:5001",
        "http://127.0.0.1:5000.evil.example",
        "http://127.0.0.1:5000/x",
    ],
)
def test_a_foreign_origin_is_refused(origin):
    for is_websocket in (False, True):
        assert GATE.check({**HOST, "Origin": origin}, {"token": "right"}, {}, is_websocket)


def test_a_websocket_must_state_its_origin():
    assert GATE.check(HOST, {"token": "right"}, {}, True)
    assert (
        GATE.check({**HOST, "Origin": "http://127.0.0.1:5000"}, {"token": "right"}, {}, True)
        is None
    )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "run" / "inner").mkdir(parents=True)
    (tmp_path / "run" / "inner" / "page.html").write_text("page")
    (tmp_path / "secret.txt").write_text("secret")
    os.symlink(tmp_path / "secret.txt", tmp_path / "run" / "link.txt")
    return tmp_path / "run"


def test_files_inside_the_folder_are_found(folder):
    assert resolve_inside(folder, "inner/page.html").read_text() == "page"


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "inner",
        "missing",
        "../secret.txt",
        "inner/../../secret.txt",
        "link.txt",
        "/etc/passwd",
        "..\\secret.txt",
        "a\x00b",
        "inner/../..//secret.txt",
    ],
)
def test_paths_outside_the_folder_are_refused(folder, name):
    assert resolve_inside(folder, name) is None


def test_images_of_a_recording_must_lie_in_its_folder(folder):
    from dataclasses import replace

    import datasets
    from workbench.app.data.recorded_images.images import overlay
    from workbench.core.errors import InputError

    rows = [{"image": "../secret.txt", "role": "board"}]
    recording = replace(datasets.read("elastic-arm"), images=rows, folder=folder)
    with pytest.raises(InputError, match="in the recording's folder"):
        overlay(recording, 0)


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    made = serve("elastic-arm", folder / "session")
    yield made
    stop(made)


def _get(served, path: str, **headers) -> tuple[int, dict, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
    host = headers.pop("Host", f"127.0.0.1:{served.port}")
    connection.putrequest("GET", path, skip_host=True)
    connection.putheader("Host", host)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    found = answer.status, dict(answer.getheaders()), answer.read()
    connection.close()
    return found


@pytest.mark.slow
def test_the_server_listens_on_the_loopback_only(served):
    table = Path("/proc/net/tcp")
    if not table.exists():
        pytest.skip("no /proc/net/tcp on this system")
    lines = [line.split() for line in table.read_text().splitlines()[1:]]
    bound = {
        line[1]
        for line in lines
        if line[3] == "0A" and int(line[1].split(":")[1], 16) == served.port
    }
    assert bound == {f"0100007F:{served.port:04X}"}


@pytest.mark.slow
def test_the_address_carries_the_token_and_sets_a_strict_cookie(served):
    status, headers, _ = _get(served, f"/?token={served.token}")
    assert status in (200, 302)
    assert re.search(rf"workbench-{served.port}=.*HttpOnly.*SameSite=Strict", headers["Set-Cookie"])
    status, headers, body = _get(
        served, "/index.html", Cookie=f"workbench-{served.port}={served.token}"
    )
    assert status == 200 and b"<html" in body
    assert headers["Content-Security-Policy"] == HEADERS["Content-Security-Policy"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", ["/", "/index.html", "/ws", "/vue.global.js", "/runs/0/answer.json", "/?token=wrong"]
)
def test_without_the_token_nothing_is_served(served, path):
    status, _, body = _get(served, path)
    assert status == 403 and b"token" in body


@pytest.mark.slow
def test_requests_from_another_page_or_to_another_name_are_refused(served):
    path = f"/?token={served.token}"
    assert _get(served, path, Origin="http://evil.example")[0] == 403
    assert _get(served, path, Host=f"evil.example:{served.port}")[0] == 403


@pytest.mark.slow
@pytest.mark.parametrize("origin", [None, "http://evil.example", "null"])
def test_a_websocket_of_another_page_is_refused(served, origin):
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    if origin:
        headers["Origin"] = origin
    assert _get(served, f"/ws?token={served.token}", **headers)[0] == 403


@pytest.mark.slow
def test_a_websocket_of_the_app_itself_is_accepted(served):
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Origin": served.origin,
    }
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
    connection.request("GET", f"/ws?token={served.token}", headers=headers)
    assert connection.getresponse().status == 101
    connection.close()


@pytest.fixture(scope="module")
def of_run(arm_run, tmp_path_factory):
    """The app on a run whose parent folder holds a secret, with links to it in the run."""
    folder = tmp_path_factory.mktemp("outside")
    (folder / "secret.txt").write_text("root: secret")
    shutil.copytree(arm_run, folder / "run")
    os.symlink(folder / "secret.txt", folder / "run" / "link.txt")
    os.symlink(folder, folder / "run" / "up")
    made = serve(folder / "run", folder / "session")
    yield made
    stop(made)


@pytest.mark.slow
def test_a_file_of_the_run_is_served_with_the_token_only(of_run):
    cookie = f"workbench-{of_run.port}={of_run.token}"
    status, headers, body = _get(of_run, "/runs/0/answer.json", Cookie=cookie)
    assert status == 200 and b"calibrate" in body and headers["Cache-Control"] == "no-store"
    assert _get(of_run, "/runs/0/answer.json")[0] == 403


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        "/runs/1/answer.json",
        "/runs/-1/answer.json",
        "/runs/0/../secret.txt",
        "/runs/0/%2e%2e/secret.txt",
        "/runs/0/..%2fsecret.txt",
        "/runs/0/..%5csecret.txt",
        "/runs/0/%252e%252e/secret.txt",
        "/runs/0/ball-centres/../../secret.txt",
        "/runs/0/link.txt",
        "/runs/0/up/secret.txt",
        "/runs/0//etc/passwd",
        "/runs/0/..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/../../etc/passwd",
        "/assets/../../../../../../etc/passwd",
        "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
    ],
)
def test_paths_outside_the_run_are_not_served_with_the_right_token_either(of_run, path):
    status, _, body = _get(of_run, path, Cookie=f"workbench-{of_run.port}={of_run.token}")
    assert status in (403, 404) and b"root:" not in body


@pytest.mark.slow
@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "HEAD"])
def test_other_methods_need_the_token_too(of_run, method):
    connection = http.client.HTTPConnection("127.0.0.1", of_run.port, timeout=60)
    connection.request(method, "/runs/0/answer.json")
    answer = connection.getresponse()
    assert answer.status == 403 and b"calibrate" not in answer.read()
    assert "Access-Control-Allow-Origin" not in dict(answer.getheaders())
    connection.close()


@pytest.mark.slow
@pytest.mark.parametrize("token", ["", "wrong", "x" * 43])
def test_a_websocket_with_a_wrong_token_is_refused(of_run, token):
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Origin": of_run.origin,
    }
    assert _get(of_run, f"/ws?token={token}", **headers)[0] == 403


@pytest.mark.slow
@pytest.mark.parametrize(("token", "status"), [(None, 200), ("wrong", 403)])
def test_the_page_asks_where_its_websocket_is(of_run, token, status):
    connection = http.client.HTTPConnection("127.0.0.1", of_run.port, timeout=30)
    connection.request("POST", f"/paraview/?token={token or of_run.token}", body="{}")
    answer = connection.getresponse()
    body = answer.read().decode()
    assert answer.status == status
    if status == 200:
        assert json.loads(body) == {"sessionURL": f"ws://127.0.0.1:{of_run.port}/ws"}


@pytest.mark.slow
def test_only_libraries_may_be_kept_by_the_browser(of_run):
    cookie = f"workbench-{of_run.port}={of_run.token}"
    page = _get(of_run, "/index.html", Cookie=cookie)
    assert page[1]["Cache-Control"] == "no-store"
    import trame_plotly.module as library

    (script,) = library.scripts
    status, headers, _ = _get(of_run, f"/{script}", Cookie=cookie)
    assert status == 200 and "immutable" in headers["Cache-Control"]
    assert _get(of_run, f"/{script}")[0] == 403
