"""The console in a browser: all of the page comes from loopback, and only its own page gets in."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import aiohttp
import pytest
import pytest_asyncio

from groundstation.cli import main
from groundstation.client.read_only import ReadOnlyClient
from groundstation.orders.grammar import OrderError
from groundstation.web import page_server
from groundstation.web.page_server import ConsoleServer
from onboard.config.endpoints import is_loopback
from onboard.config.fleet import ConfigError
from tests.groundstation.recorded import FLEET, record

_LINK = re.compile(
    r"""(?:href|src|data-session-websocket-url)\s*=\s*["']([^"']*)["']|url\(\s*["']?([^"')]*)"""
)


@pytest_asyncio.fixture
async def served(tmp_path: Path) -> AsyncIterator[tuple[ConsoleServer, str]]:
    folder = record(tmp_path / "flight", 3.0)
    command = [sys.executable, "-m", "groundstation", "replay", str(folder)]
    server = ConsoleServer(command, title='a <b>"flight"', ended="over")
    address = await server.start("127.0.0.1", 0)
    yield server, address
    await server.stop()


# A console that draws all the time and hears nothing, as one that is opening does; its arguments
# are two waits [s].
_DEAF = """
import os, signal, sys, time
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
time.sleep(float(sys.argv[1]))
os.write(1, b"__GANGLION__\\n")
while True:
    try:
        os.write(1, b"D" + (4000).to_bytes(4, "big") + bytes(4000))
    except OSError:
        pass
    time.sleep(float(sys.argv[2]))
"""


def deaf_console(opening_s: float = 0.3, pause_s: float = 0.001) -> list[str]:
    return [sys.executable, "-c", _DEAF, str(opening_s), str(pause_s)]


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def children_of(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


async def until(condition: Callable[[], bool], timeout_s: float = 30.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 - nobody tells of a process's end
            await asyncio.sleep(0.02)


async def test_everything_that_the_page_loads_comes_from_this_server(
    served: tuple[ConsoleServer, str],
) -> None:
    _, address = served
    seen: set[str] = set()
    todo = [address]
    async with aiohttp.ClientSession() as session:
        while todo:
            url = todo.pop()
            async with session.get(url) as response:
                assert response.status == 200, url
                assert (
                    "default-src 'none'" in response.headers["Content-Security-Policy"]
                    or "/static/" in url
                )
                body = await response.read()
                if not response.content_type.startswith(("text/html", "text/css")):
                    continue
            for groups in _LINK.findall(body.decode()):
                link = next((group for group in groups if group), "")
                if not link or link.startswith("data:"):
                    continue
                target = urljoin(url, link)
                assert urlsplit(target).netloc == urlsplit(address).netloc, (
                    f"{url} refers to {target}"
                )
                if target not in seen and not target.startswith("ws:"):
                    seen.add(target)
                    todo.append(target)
        async with session.get(address) as response:
            text = await response.text()
    assert "a &lt;b&gt;&quot;flight&quot;" in text
    assert any(name.endswith(".ttf") for name in seen)
    assert any(name.endswith("textual.js") for name in seen)


async def test_a_page_gets_a_console_of_its_own_which_ends_with_it(
    served: tuple[ConsoleServer, str],
) -> None:
    server, address = served
    async with aiohttp.ClientSession() as session:
        socket = await session.ws_connect(
            f"{address}ws?width=100&height=30", origin=address.rstrip("/")
        )
        seen = b""
        async with asyncio.timeout(60):
            while b"mav2" not in seen:
                message = await socket.receive()
                assert message.type in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT), message
                seen += message.data if isinstance(message.data, bytes) else b""
            await socket.send_str("no message at all")
            await socket.send_json(["resize", {"width": 1e9, "height": "x"}])
            await socket.send_json(["ping", 7])
            while (message := await socket.receive()).type is not aiohttp.WSMsgType.TEXT:
                pass
            assert message.json() == ["pong", 7]
        (pid,) = server.pids
        await socket.close()
        await until(lambda: not server.pages)
        assert not is_running(pid)


@pytest.mark.parametrize(
    "is_closed_first", [True, False], ids=["the page is closed first", "the page is open"]
)
async def test_no_console_outlives_its_server_however_deaf_it_is(is_closed_first: bool) -> None:
    for opening_s, pause_s in ((0.0, 0.001), (0.3, 0.001), (60.0, 1.0)):
        server = ConsoleServer(deaf_console(opening_s, pause_s), title="", ended="")
        address = await server.start("127.0.0.1", 0)
        async with aiohttp.ClientSession() as session:
            socket = await session.ws_connect(f"{address}ws")
            await until(lambda server=server: bool(server.pids))  # type: ignore[misc]
            (pid,) = server.pids
            if is_closed_first:
                await socket.close()
            await server.stop()
            assert not is_running(pid), (opening_s, pause_s)
            assert server.pages == 0


async def test_a_console_whose_page_was_closed_while_it_opened_ends_without_its_server() -> None:
    server = ConsoleServer(deaf_console(), title="", ended="")
    address = await server.start("127.0.0.1", 0)
    async with aiohttp.ClientSession() as session:
        socket = await session.ws_connect(f"{address}ws")
        await until(lambda: bool(server.pids))
        (pid,) = server.pids
        await socket.close()
        await until(lambda: not server.pages)
    assert not is_running(pid)
    await server.stop()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
async def test_no_console_outlives_covey_web(number: signal.Signals, tmp_path: Path) -> None:
    folder = record(tmp_path / "flight", 3.0)
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "groundstation",
        "web",
        "--replay",
        str(folder),
        "--port",
        "0",
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        address = re.search(r"http://\S+", (await process.stdout.readline()).decode())
        assert address is not None
        async with aiohttp.ClientSession() as session:
            socket = await session.ws_connect(f"{address[0]}ws")
            await until(lambda: bool(children_of(process.pid)))
            pids = children_of(process.pid)
            await socket.close()  # while the console opens
            process.send_signal(number)
            async with asyncio.timeout(30):
                await process.wait()
            await until(lambda: not any(is_running(pid) for pid in pids))
    finally:
        if process.returncode is None:
            process.kill()


async def test_pages_that_can_order_are_served_behind_a_key_only() -> None:
    server = ConsoleServer(deaf_console(), title="t", ended="e", key="a-secret")
    address = await server.start("127.0.0.1", 0)
    root = address.removesuffix("a-secret/")
    assert root != address
    async with aiohttp.ClientSession() as session:
        for base in (
            root,
            f"{root}a-secre/",
            f"{root}A-SECRET/",
            f"{root}x/a-secret/",
            f"{root}?key=a-secret",
            f"{root}%ff/",
        ):
            for path in ("", "ws", "page.js", "page.css", "static/js/textual.js", "nothing"):
                async with session.get(base + path) as response:
                    assert response.status == 403, base + path
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await session.ws_connect(f"{base}ws")
        assert server.pages == 0
        async with session.get(address) as response:
            assert response.status == 200
            assert f'"{address.replace("http", "ws")}ws"' in await response.text()
        for path in ("page.js", "page.css", "static/js/textual.js"):
            async with session.get(address + path) as response:
                assert response.status == 200, path
        socket = await session.ws_connect(f"{address}ws")
        assert (await socket.receive()).type is aiohttp.WSMsgType.BINARY
        await socket.close()
    await server.stop()


async def test_the_address_that_covey_web_prints_has_a_key_exactly_when_its_pages_can_order() -> (
    None
):
    for words in ([], ["--operate"]):
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "groundstation",
            "web",
            "--fleet",
            str(FLEET),
            "--port",
            "0",
            *words,
            stdout=asyncio.subprocess.PIPE,
        )
        assert process.stdout is not None
        address = re.search(r"http://\S+", (await process.stdout.readline()).decode())
        process.terminate()
        await process.wait()
        assert address is not None
        assert len(urlsplit(address[0]).path) > 32 if words else urlsplit(address[0]).path == "/"


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Host": "evil.example:80"},
        {"Host": "127.0.0.1.evil.example"},
    ],
)
async def test_other_pages_and_other_names_are_refused(
    served: tuple[ConsoleServer, str], headers: dict[str, str]
) -> None:
    server, address = served
    async with aiohttp.ClientSession() as session:
        for path in ("", "ws", "static/js/textual.js"):
            async with session.get(
                address + path, headers={"Upgrade": "websocket", **headers}
            ) as response:
                assert response.status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await session.ws_connect(f"{address}ws", headers=headers)
    assert server.pages == 0


async def test_pages_beyond_the_limit_are_turned_away(
    served: tuple[ConsoleServer, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    server, address = served
    monkeypatch.setattr(page_server, "MAX_PAGES", 0)
    async with aiohttp.ClientSession() as session:
        socket = await session.ws_connect(f"{address}ws")
        assert (await socket.receive()).type is aiohttp.WSMsgType.CLOSE
        assert socket.close_code == aiohttp.WSCloseCode.TRY_AGAIN_LATER
    assert server.pages == 0


@pytest.mark.parametrize(
    "words",
    [
        ["--fleet", str(FLEET), "--host", "0.0.0.0"],
        ["--fleet", str(FLEET), "--host", "192.168.1.7"],
        ["--fleet", str(FLEET), "--host", "ground-station.example"],
        ["--fleet", "nothing.toml"],
        ["--replay", "nothing"],
        ["--replay", "nothing", "--operate"],
        ["--fleet", str(FLEET), "--port", "70000"],
    ],
)
def test_what_cannot_be_served_is_refused_in_words(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["web", *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith("covey: ")
    assert "0.0.0.0" not in words or "this machine only" in said


async def test_a_port_that_is_taken_is_a_sentence(served: tuple[ConsoleServer, str]) -> None:
    with pytest.raises(ConfigError, match="Choose another"):
        await ConsoleServer(["x"], title="", ended="").start(
            "127.0.0.1", urlsplit(served[1]).port or 0
        )


@pytest.mark.parametrize(
    ("host", "is_ours"),
    [
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("[::1]", True),
        ("localhost", True),
        ("::", False),
        ("10.0.0.1", False),
        ("127.0.0.1.example.org", False),
        ("", False),
        ("0", False),
    ],
)
def test_only_loopback_counts_as_this_machine(host: str, is_ours: bool) -> None:
    assert is_loopback(host) is is_ours


async def test_a_console_that_only_watches_sends_no_order_at_all() -> None:
    class Client:
        async def submit(self, order: object) -> None:
            raise AssertionError("an order left the console")

    for order in ("land all", "kill mav0", "takeoff all"):
        with pytest.raises(OrderError, match="only watches"):
            await ReadOnlyClient(Client()).submit(order)  # type: ignore[arg-type]
