"""The zoo's table, and fetching from a small server on this machine that can be made to misbehave."""

from __future__ import annotations

import dataclasses
import hashlib
import http.server
import sqlite3
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from salad.errors import FetchError, WeightsError
from salad.models import hub
from salad.models import hub as downloads
from salad.models.hub import ZOO, ZooEntry, fetch, home, path_of

BODY = bytes(range(256)) * 1000
SHA256 = hashlib.sha256(BODY).hexdigest()


class Published(http.server.ThreadingHTTPServer):
    """Serves one file, and does as its fields say."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.body = BODY
        self.ranges = True  # whether it understands Range
        self.tag: str | None = '"v1"'
        self.modified: str | None = None
        self.drop_after: int | None = None  # bytes of an answer after which the connection is cut
        self.status: int | None = None
        self.content_range: str | None = None  # a wrong one to send
        self.says_length = True
        self.moved_to: str | None = None
        self.asked: list[dict[str, str]] = []

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that hangs up is no news."""


class Handler(http.server.BaseHTTPRequestHandler):
    server: Published

    def do_GET(self) -> None:
        publish = self.server
        publish.asked.append(dict(self.headers))
        if publish.moved_to and self.path == "/tiny.pth":
            self._head(302, {"Location": publish.moved_to, "Content-Length": "0"})
            return
        if publish.status:
            self.send_error(publish.status)
            return
        start = self._start()
        if start is not None and start >= len(publish.body):
            self._head(416, {"Content-Range": f"bytes */{len(publish.body)}", "Content-Length": "0"})
            return
        body = publish.body[start or 0 :]
        headers = {"ETag": publish.tag, "Last-Modified": publish.modified}
        if publish.says_length:
            headers["Content-Length"] = str(len(body))
        if start is not None:
            whole = f"bytes {start}-{len(publish.body) - 1}/{len(publish.body)}"
            headers["Content-Range"] = publish.content_range or whole
        self._head(200 if start is None else 206, headers)
        self.wfile.write(body[: publish.drop_after])

    def _start(self) -> int | None:
        asked = self.headers.get("Range")
        version = self.headers.get("If-Range")
        if not asked or not self.server.ranges:
            return None
        if version and version not in (self.server.tag, self.server.modified):
            return None
        return int(asked.removeprefix("bytes=").removesuffix("-"))

    def _head(self, status: int, headers: dict[str, str | None]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            if value is not None:
                self.send_header(name, value)
        self.end_headers()

    def log_message(self, *args: Any) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[Published]:
    with Published() as publish:
        thread = threading.Thread(target=publish.serve_forever, args=(0.01,))
        thread.start()
        yield publish
        publish.shutdown()
        thread.join()


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SALAD_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    return tmp_path / "home" / "weights" / "tiny"


@pytest.fixture
def tiny(server: Published, monkeypatch: pytest.MonkeyPatch) -> ZooEntry:
    row = ZooEntry("tiny", f"http://127.0.0.1:{server.server_port}/tiny.pth", "tiny.pth", "hub", 4, "MIT")
    monkeypatch.setitem(ZOO, "tiny", row)
    return row


def offline(*_: Any, **__: Any) -> Any:
    pytest.fail("the network was used")


def known(monkeypatch: pytest.MonkeyPatch, row: ZooEntry, **fields: Any) -> None:
    monkeypatch.setitem(ZOO, "tiny", dataclasses.replace(row, **fields))


def leave_part(cache: Path, part: bytes, version: str | None = None) -> None:
    cache.mkdir(parents=True)
    (cache / "tiny.pth.part").write_bytes(part)
    if version:
        (cache / "tiny.pth.part.version").write_text(version)


def left(cache: Path) -> set[str]:
    return {path.name for path in cache.iterdir() if path.suffix != ".lock"}


class TestTable:
    def test_rows(self) -> None:
        assert all(row.name == name for name, row in ZOO.items())
        dinov2 = {f"dinov2-vit{size}14{kind}" for size in "sblg" for kind in ("", "-reg")}
        assert set(ZOO) == {"salad-lite", "salad-lite-route", "salad-vits", "dinov2-salad", "megaloc"} | dinov2
        for row in ZOO.values():
            assert row.licence
            assert row.note
            assert row.url is None or (row.url.startswith("https://") and row.url.endswith("/" + row.file))

    def test_every_file_has_its_own_place(self) -> None:
        assert len({path_of(name) for name in ZOO}) == len(ZOO)

    def test_a_register_backbone(self) -> None:
        row = hub.entry("dinov2-vitb14-reg")
        assert (row.dim, row.file) == (768, "dinov2_vitb14_reg4_pretrain.pth")
        assert row.url == "https://dl.fbaipublicfiles.com/dinov2/dinov2_vitb14/dinov2_vitb14_reg4_pretrain.pth"

    def test_an_unknown_name(self) -> None:
        with pytest.raises(
            WeightsError, match="'resnet': the zoo has salad-lite, salad-lite-route, salad-vits, dinov2-salad"
        ):
            fetch("resnet")


class TestHome:
    def test_by_variable(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SALAD_HOME", "~/models")
        assert home() == Path.home() / "models"

    def test_by_platform(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("SALAD_HOME")
        assert "salad" in home().parts


class TestBundled:
    def test_there(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setattr(hub, "__file__", str(tmp_path / "salad" / "model" / "zoo.py"))
        folder = tmp_path / "salad" / "weights" / "salad-lite"
        with pytest.raises(WeightsError, match="install the package again"):
            fetch("salad-lite", opener=offline)
        folder.mkdir(parents=True)
        assert fetch("salad-lite", opener=offline) == folder


class TestFetch:
    def test_once(self, tiny: ZooEntry, cache: Path) -> None:
        seen: list[tuple[int, int | None]] = []
        path = fetch("tiny", progress=lambda done, total: seen.append((done, total)))
        assert path == cache / "tiny.pth"
        assert path.read_bytes() == BODY
        assert seen[-1] == (len(BODY), len(BODY))
        assert left(cache) == {"tiny.pth", "tiny.pth.sha256"}
        assert (cache / "tiny.pth.sha256").read_text() == f"{SHA256}  tiny.pth\n"
        assert fetch("tiny", opener=offline) == path

    def test_known_length_and_checksum(self, tiny: ZooEntry, monkeypatch: pytest.MonkeyPatch) -> None:
        known(monkeypatch, tiny, sha256=SHA256, bytes=len(BODY))
        assert fetch("tiny").read_bytes() == BODY
        assert fetch("tiny", opener=offline).read_bytes() == BODY

    def test_a_server_that_does_not_say_how_much(self, tiny: ZooEntry, server: Published) -> None:
        server.says_length = False
        seen: list[int | None] = []
        assert fetch("tiny", progress=lambda _, total: seen.append(total)).read_bytes() == BODY
        assert set(seen) == {None}

    @pytest.mark.parametrize("fields", [{"sha256": "0" * 64}, {"bytes": 10}, {"bytes": 10**6}])
    def test_not_what_was_due(
        self, tiny: ZooEntry, cache: Path, monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any]
    ) -> None:
        known(monkeypatch, tiny, **fields)
        with pytest.raises(FetchError, match=SHA256):
            fetch("tiny")
        assert not {"tiny.pth", "tiny.pth.part"} & left(cache)

    def test_not_found(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        server.status = 404
        with pytest.raises(FetchError) as caught:
            fetch("tiny")
        assert "the server answered 404" in str(caught.value)
        assert f"download {tiny.url} on a machine with a network and put it at {cache / 'tiny.pth'}" in str(
            caught.value
        )
        assert not left(cache)

    def test_no_network(self, tiny: ZooEntry, server: Published, monkeypatch: pytest.MonkeyPatch) -> None:
        with Published() as gone:
            port = gone.server_port
        known(monkeypatch, tiny, url=f"http://127.0.0.1:{port}/tiny.pth")
        with pytest.raises(FetchError, match=r"no connection: .*put it at .*tiny\.pth$"):
            fetch("tiny")

    def test_a_folder_that_cannot_be_made(self, tiny: ZooEntry, tmp_path: Path) -> None:
        (tmp_path / "home").write_text("a file stands here")
        with pytest.raises(FetchError, match="could not fetch 'tiny'"):
            fetch("tiny", opener=offline)

    @pytest.mark.parametrize("url", ["http://example.org/tiny.pth", "ftp://127.0.0.1/t", "file:///etc/hosts"])
    def test_only_https(self, tiny: ZooEntry, monkeypatch: pytest.MonkeyPatch, url: str) -> None:
        known(monkeypatch, tiny, url=url)
        with pytest.raises(FetchError, match="not an https address"):
            fetch("tiny", opener=offline)

    def test_nor_after_a_redirect(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        server.moved_to = f"http://localhost:{server.server_port}/elsewhere.pth"
        with pytest.raises(FetchError, match=r"localhost\S+ is not an https address"):
            fetch("tiny")
        assert not left(cache)

    def test_a_redirect_is_followed(self, tiny: ZooEntry, server: Published) -> None:
        server.moved_to = f"http://127.0.0.1:{server.server_port}/elsewhere.pth"
        assert fetch("tiny").read_bytes() == BODY


class TestResume:
    def test_after_a_broken_connection(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        server.drop_after = 100_000
        with pytest.raises(FetchError, match=r"broke off after 100000 of 256000 bytes.*try again"):
            fetch("tiny")
        assert left(cache) == {"tiny.pth.part", "tiny.pth.part.version"}
        server.drop_after = None
        seen: list[tuple[int, int | None]] = []
        assert fetch("tiny", progress=lambda *now: seen.append(now)).read_bytes() == BODY
        assert seen == [(len(BODY), len(BODY))]
        assert server.asked[-1]["Range"] == "bytes=100000-"
        assert server.asked[-1]["If-Range"] == '"v1"'
        assert left(cache) == {"tiny.pth", "tiny.pth.sha256"}

    def test_again_and_again(self, tiny: ZooEntry, server: Published) -> None:
        server.drop_after = 100_000
        for _ in range(2):
            with pytest.raises(FetchError, match="broke off"):
                fetch("tiny")
        assert fetch("tiny").read_bytes() == BODY

    def test_a_server_without_ranges_starts_over(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        leave_part(cache, BODY[:500])
        server.ranges = False
        assert fetch("tiny").read_bytes() == BODY

    def test_a_file_published_anew_starts_over(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        leave_part(cache, b"\0" * 500, '"v0"')
        assert fetch("tiny").read_bytes() == BODY

    def test_the_date_stands_in_for_a_weak_tag(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        server.tag, server.modified = 'W/"v1"', "Tue, 14 Nov 2023 22:13:20 GMT"
        server.drop_after = 1000
        with pytest.raises(FetchError):
            fetch("tiny")
        server.drop_after = None
        assert fetch("tiny").read_bytes() == BODY
        assert server.asked[-1]["If-Range"] == server.modified

    def test_a_server_that_says_nothing_of_versions(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        server.tag = None
        leave_part(cache, BODY[:500])
        assert fetch("tiny").read_bytes() == BODY
        assert server.asked[-1]["Range"] == "bytes=500-"

    def test_all_there_but_for_the_name(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        leave_part(cache, BODY, '"v1"')
        assert fetch("tiny").read_bytes() == BODY
        assert len(server.asked) == 1

    def test_more_than_there_is(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        leave_part(cache, BODY + b"more")
        assert fetch("tiny").read_bytes() == BODY

    def test_another_part_than_asked_for(self, tiny: ZooEntry, server: Published, cache: Path) -> None:
        leave_part(cache, BODY[:500])
        server.content_range = "bytes 0-9/10"
        with pytest.raises(FetchError, match="another part"):
            fetch("tiny")
        assert fetch("tiny").read_bytes() == BODY

    def test_interrupted_by_hand(self, tiny: ZooEntry, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(downloads, "_CHUNK", 50_000)

        def stop(done: int, total: int | None) -> None:
            if done == 100_000:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fetch("tiny", progress=stop)
        assert (cache / "tiny.pth.part").read_bytes() == BODY[:100_000]
        assert fetch("tiny").read_bytes() == BODY


class TestChecksum:
    def test_recorded_at_first_use_of_a_file_put_by_hand(self, tiny: ZooEntry, cache: Path) -> None:
        cache.mkdir(parents=True)
        (cache / "tiny.pth").write_bytes(BODY)
        fetch("tiny", opener=offline)
        assert SHA256 in (cache / "tiny.pth.sha256").read_text()
        (cache / "tiny.pth").write_bytes(BODY[:-1])
        with pytest.raises(WeightsError, match=rf"where {SHA256} was due.*delete it together with tiny\.pth"):
            fetch("tiny", opener=offline)

    def test_the_table_rules(self, tiny: ZooEntry, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        known(monkeypatch, tiny, sha256="0" * 64)
        cache.mkdir(parents=True)
        (cache / "tiny.pth").write_bytes(BODY)
        with pytest.raises(WeightsError, match="where 0000"):
            fetch("tiny", opener=offline)

    def test_a_cache_that_cannot_be_written(self, tiny: ZooEntry, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: Any) -> None:
            raise PermissionError("read-only")

        cache.mkdir(parents=True)
        (cache / "tiny.pth").write_bytes(BODY)
        monkeypatch.setattr(downloads, "write_whole", refuse)
        assert fetch("tiny", opener=offline).read_bytes() == BODY


class TestTogether:
    def test_many_at_once_download_once(self, tiny: ZooEntry, server: Published) -> None:
        with ThreadPoolExecutor(6) as pool:
            paths = list(pool.map(lambda _: fetch("tiny"), range(6)))
        assert {path.read_bytes() for path in paths} == {BODY}
        assert len(server.asked) == 1

    def test_waits_for_another_process(self, tiny: ZooEntry, cache: Path) -> None:
        cache.mkdir(parents=True)
        with closing(sqlite3.connect(cache / "tiny.pth.lock", isolation_level=None)) as other:
            other.execute("BEGIN EXCLUSIVE")
            with ThreadPoolExecutor(1) as pool:
                waiting = pool.submit(fetch, "tiny", opener=offline)
                with pytest.raises(TimeoutError):
                    waiting.result(timeout=0.7)
                (cache / "tiny.pth").write_bytes(BODY)
                other.rollback()
                assert waiting.result().read_bytes() == BODY

    def test_a_lock_that_is_none(self, tiny: ZooEntry, cache: Path) -> None:
        (cache / "tiny.pth.lock").mkdir(parents=True)
        with pytest.raises(FetchError, match=r"cannot lock .*tiny\.pth\.lock"):
            fetch("tiny", opener=offline)
