"""`session.show()`: the page of the session's own frames, seen by a program that speaks its protocol."""

import base64
import json
import os
import socket
import struct
import urllib.error
import urllib.request
from urllib.parse import urlsplit

import numpy as np
import pytest

import dermis


class Page:
    """A page without a browser."""

    def __init__(self, address):
        host = urlsplit(address).netloc
        name, port = host.split(":")
        self.stream = socket.create_connection((name, int(port)), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        lines = ["GET /ws HTTP/1.1", f"Host: {host}", f"Origin: http://{host}", "Connection: Upgrade", "Upgrade: websocket"]
        lines += ["Sec-WebSocket-Version: 13", f"Sec-WebSocket-Key: {key}", "", ""]
        self.stream.sendall("\r\n".join(lines).encode())
        self.kept = b""
        while b"\r\n\r\n" not in self.kept:
            self.kept += self.stream.recv(4096)
        head, self.kept = self.kept.split(b"\r\n\r\n", 1)
        assert b" 101 " in head.split(b"\r\n")[0], head

    def take(self, count):
        while len(self.kept) < count:
            more = self.stream.recv(65536)
            assert more, "the page was closed"
            self.kept += more
        taken, self.kept = self.kept[:count], self.kept[count:]
        return taken

    def message(self):
        """The next message: a dictionary, or the bytes of an image or of channels."""
        kind, length = self.take(2)
        if length == 126:
            (length,) = struct.unpack(">H", self.take(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self.take(8))
        body = self.take(length)
        return json.loads(body) if kind & 15 == 1 else body

    def until(self, wanted):
        while True:
            message = self.message()
            if wanted(message):
                return message

    def send(self, what):
        body = json.dumps({"v": 1, **what}).encode()
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[at % 4] for at, byte in enumerate(body))
        assert len(body) < 65536
        size = bytes([0x80 | len(body)]) if len(body) < 126 else bytes([0x80 | 126]) + struct.pack(">H", len(body))
        self.stream.sendall(b"\x81" + size + mask + masked)


def is_kind(kind):
    return lambda message: isinstance(message, dict) and message.get("type") == kind


def test_the_page_shows_what_the_session_has(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with dermis.open("twin:ionic-disc") as session:
        address = session.show(browser=False)
        assert session.show(browser=False) == address
        assert b"<html" in urllib.request.urlopen(address).read()
        page = Page(address)
        scene = page.until(is_kind("scene"))
        assert scene["skin"] == "ionic-disc" and scene["is_twin"]
        for _ in range(40):
            result = next(session)
        # Every update is acknowledged, so the newest one is of the frame that the loop saw last.
        image = page.until(lambda message: isinstance(message, bytes) and message[6:8] == b"\1\0" and frame_of(message) == result.sequence)
        rows, columns = struct.unpack("<II", image[24:32])
        np.testing.assert_array_equal(np.frombuffer(image, "<f4", offset=32).reshape(rows, columns), result.image)
        state = page.until(is_kind("state"))
        assert state["frame"] == result.sequence and state["state"]["hyperparameter"] is not None
        page.send({"ack": state["sequence"]})
        # Requests from the page are carried out before the next frame.
        page.send({"id": 7, "command": {"hyperparameter": 0.125}})
        page.send({"id": 8, "command": "record_start"})
        answers = {}
        for _ in range(2000):
            next(session)
            if len(answers) < 2 and (message := page.message()) and isinstance(message, dict):
                if message["type"] == "answer":
                    answers[message["id"]] = message
                elif message["type"] == "state":
                    page.send({"ack": message["sequence"]})
            if len(answers) == 2:
                break
        assert answers[7]["ok"] and answers[8]["ok"], answers
        for _ in range(5):
            next(session)
    (recorded,) = tmp_path.glob("*.mcap")
    assert len(dermis.Recording(recorded).frames()) >= 5
    with pytest.raises((urllib.error.URLError, OSError)):
        urllib.request.urlopen(address, timeout=10)
    with pytest.raises(dermis.SessionError, match="closed"):
        session.show(browser=False)


def frame_of(message):
    return struct.unpack("<Q", message[8:16])[0]


def test_a_port_that_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as taken, dermis.open("twin:ionic-disc") as session:
        with pytest.raises(dermis.Error, match="port"):
            session.show(port=taken.getsockname()[1], browser=False)
        assert session.show(browser=False).startswith("http://127.0.0.1:")
        with pytest.raises(OverflowError):
            session.show(port=70000)
