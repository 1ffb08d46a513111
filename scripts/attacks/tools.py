"""Shared by all attacks: the command as a monitored process, a page's socket, figures and conditions."""

import base64
import json
import os
import random
import re
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ATTACKS = {}
# Rust's messages for panics and aborts, and fatal signals that the attack didn't send.
PANIC = re.compile(r"panicked at|RUST_BACKTRACE|stack overflow|memory allocation of \d+ bytes failed")
FATAL = {-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS, -signal.SIGILL, -signal.SIGFPE, 101}


class NotHeld(Exception):
    """An attack found a failure."""


@dataclass
class Attack:
    name: str
    about: str
    run: object


def attack(name, about):
    """Registers an attack."""

    def register(function):
        ATTACKS[name] = Attack(name, about, function)
        return function

    return register


def check(condition, text):
    if not condition:
        raise NotHeld(text)


def dermis():
    """Path of the command under attack."""
    named = os.environ.get("DERMIS_BIN")
    places = [Path(named)] if named else [ROOT / "target" / kind / "dermis" for kind in ("release", "debug")]
    for place in places:
        if os.access(place, os.X_OK):
            return place.resolve()
    raise SystemExit(f"attack: no command at {' or '.join(map(str, places))}: cargo build --release, or set DERMIS_BIN")


class Ground:
    """Working area of an attack: its own folder, its processes and its messages."""

    def __init__(self, options):
        self.folder = Path(tempfile.mkdtemp(prefix="dermis-attack-"))
        self.random = random.Random(options.seed)
        self.options = options
        self.processes = []

    def say(self, text):
        print(f"  {text}", flush=True)

    def start(self, *arguments, **keywords):
        """Starts the command in the attack's folder."""
        process = Process([str(dermis()), *map(str, arguments)], self.folder, **keywords)
        self.processes.append(process)
        return process

    def ask(self, *arguments, timeout=120, **keywords):
        """Runs the command to its end."""
        process = self.start(*arguments, **keywords)
        try:
            process.wait(timeout)
        finally:
            process.kill()
        return process

    def skin(self, name, text):
        path = self.folder / name
        path.write_text(text)
        return path

    def end(self):
        for process in self.processes:
            process.kill()
        if not self.options.keep:
            shutil.rmtree(self.folder, ignore_errors=True)


def carry_out(what, options):
    print(f"{what.name}: {what.about}", flush=True)
    ground = Ground(options)
    try:
        what.run(ground)
        for process in ground.processes:
            process.check_sound()
        return True
    except NotHeld as error:
        print(f"  not held: {error}", flush=True)
        return False
    except Exception:  # noqa: BLE001: an attack that breaks has not shown anything
        traceback.print_exc()
        return False
    finally:
        ground.end()


class Process:
    """The running command. Its output goes to files, so that it never waits for a reader."""

    def __init__(self, command, folder, stdin=False, preexec=None, env=None):
        self.name = " ".join(Path(command[0]).name if k == 0 else word for k, word in enumerate(command))
        self.out_file = tempfile.NamedTemporaryFile(prefix="out-", dir=folder, delete=False)  # noqa: SIM115
        self.err_file = tempfile.NamedTemporaryFile(prefix="err-", dir=folder, delete=False)  # noqa: SIM115
        self.usage = None
        self.code = None
        self.begun = time.monotonic()
        self.peak = 0
        self.popen = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE if stdin else subprocess.DEVNULL,
            stdout=self.out_file,
            stderr=self.err_file,
            preexec_fn=preexec,
            env={**os.environ, "RUST_BACKTRACE": "0", "NO_COLOR": "1", **(env or {})},
            start_new_session=True,
        )
        self.pid = self.popen.pid

    def out(self):
        return Path(self.out_file.name).read_text(errors="replace")

    def err(self):
        return Path(self.err_file.name).read_text(errors="replace")

    def poll(self):
        """The exit status, if it has ended; also records its resource usage."""
        if self.code is None:
            pid, status, usage = os.wait4(self.pid, os.WNOHANG)
            if pid:
                self.usage = usage
                self.code = os.waitstatus_to_exitcode(status)
                self.popen.returncode = self.code
                self.took = time.monotonic() - self.begun
        return self.code

    def wait(self, timeout):
        end = time.monotonic() + timeout
        while self.poll() is None:
            check(time.monotonic() < end, f"{self.name}: still running after {timeout} s: {self.err()[-400:]}")
            time.sleep(0.01)
        return self.code

    def signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        if self.popen.stdin:
            try:
                self.popen.stdin.close()
            except OSError:
                pass
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
            while self.poll() is None:
                time.sleep(0.005)

    def type(self, text):
        """Writes to the command's standard input."""
        self.popen.stdin.write(text.encode() if isinstance(text, str) else text)
        self.popen.stdin.flush()

    def peak_mb(self):
        """Peak memory, once it has ended."""
        return self.usage.ru_maxrss / 1024

    def memory_mb(self):
        """Current memory."""
        try:
            text = Path(f"/proc/{self.pid}/status").read_text()
        except OSError:
            return 0.0
        found = re.search(r"VmRSS:\s+(\d+) kB", text)
        return int(found[1]) / 1024 if found else 0.0

    def until(self, pattern, timeout=60, where="both"):
        """Waits until the command has written something."""
        end = time.monotonic() + timeout
        while True:
            text = {"out": self.out, "err": self.err, "both": lambda: self.out() + self.err()}[where]()
            found = re.search(pattern, text)
            if found:
                return found
            if self.poll() is not None:
                found = re.search(pattern, self.out() + self.err())
                check(found, f"{self.name}: ended with {self.code} before /{pattern}/: {self.err()[-600:]}")
                return found
            check(time.monotonic() < end, f"{self.name}: no /{pattern}/ within {timeout} s: {self.err()[-600:]}")
            time.sleep(0.02)

    def url(self):
        """Host and port of the command's page."""
        found = self.until(r"page: http://([\d.]+):(\d+)", 120)
        return found[1], int(found[2])

    def port(self):
        """Port of a served twin."""
        return int(self.until(r"--source tcp:[\d.]+:(\d+)", 120)[1])

    def check_sound(self):
        """Checks for panics and aborts, and for control characters in the output."""
        text = self.out() + self.err()
        check(not PANIC.search(text), f"{self.name}: a panic: {text[-600:]}")
        check(self.code not in FATAL, f"{self.name}: ended with {self.code}: {text[-600:]}")
        check("\x1b" not in text and "\x07" not in text, f"{self.name}: control characters: {text[-600:]!r}")


class Page:
    """One page: a WebSocket read by a separate thread."""

    def __init__(self, address, acknowledges=True, reads=True, receive_buffer=None):
        self.socket = socket.socket()
        if receive_buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.settimeout(30)
        self.socket.connect(address)
        host = f"{address[0]}:{address[1]}"
        status, rest = shake_hands(self.socket, host, f"http://{host}")
        check(status == 101, f"the page's socket was refused with {status}")
        self.buffer = bytearray(rest)
        self.acknowledges = acknowledges
        self.states = []
        self.answers = []
        self.notices = []
        self.close_code = None
        self.ended = False
        self.next_id = 0
        self.lock = threading.Lock()
        if reads:
            self.thread = threading.Thread(target=self._read, daemon=True)
            self.thread.start()

    def _take(self, count):
        while len(self.buffer) < count:
            data = self.socket.recv(65536)
            if not data:
                raise ConnectionError("closed")
            self.buffer += data
        taken, self.buffer[:count] = bytes(self.buffer[:count]), b""
        return taken

    def _read(self):
        self.socket.settimeout(None)
        try:
            while True:
                first, second = self._take(2)
                length = second & 0x7F
                if length == 126:
                    (length,) = struct.unpack(">H", self._take(2))
                elif length == 127:
                    (length,) = struct.unpack(">Q", self._take(8))
                data = self._take(length)
                kind = first & 0xF
                if kind == 8:
                    self.close_code = struct.unpack(">H", data[:2])[0] if len(data) >= 2 else 1005
                    break
                if kind == 1:
                    self._text(json.loads(data))
        except (OSError, ConnectionError, ValueError):
            pass
        self.ended = True

    def _text(self, message):
        if message["type"] == "state":
            self.states.append((time.monotonic(), message))
            if self.acknowledges:
                self.send({"v": 1, "ack": message["sequence"]})
        elif message["type"] == "answer":
            self.answers.append(message)
        elif message["type"] == "notice":
            self.notices.append(message["text"])

    def frame(self, payload, kind=1):
        """Sends a masked frame of the WebSocket protocol."""
        mask = os.urandom(4)
        length = len(payload)
        if length < 126:
            head = struct.pack(">BB", 0x80 | kind, 0x80 | length)
        elif length < 65536:
            head = struct.pack(">BBH", 0x80 | kind, 0xFE, length)
        else:
            head = struct.pack(">BBQ", 0x80 | kind, 0xFF, length)
        masks = (mask * (length // 4 + 1))[:length]
        masked = (int.from_bytes(payload, "big") ^ int.from_bytes(masks, "big")).to_bytes(length, "big")
        with self.lock:
            self.socket.sendall(head + mask + masked)

    def send(self, message):
        try:
            self.frame(json.dumps(message).encode())
        except OSError:
            self.ended = True

    def ask(self, command):
        """Sends a command and returns its number."""
        self.next_id += 1
        self.send({"v": 1, "id": self.next_id, "command": command})
        return self.next_id

    def wait_for(self, condition, timeout, what):
        end = time.monotonic() + timeout
        while not condition():
            check(not self.ended, f"the page was closed ({self.close_code}) while waiting for {what}")
            check(time.monotonic() < end, f"no {what} within {timeout} s")
            time.sleep(0.02)

    def runs(self, frames=5, timeout=60):
        """Waits for this many further states after the baseline."""
        tared = lambda: self.states and self.states[-1][1]["state"]["tare"]["kind"] == "tared"  # noqa: E731
        self.wait_for(tared, timeout, "baseline")
        count = len(self.states) + frames
        self.wait_for(lambda: len(self.states) >= count, timeout, "frames")

    def gap(self, since):
        """The longest time without a state since a moment."""
        times = [since] + [at for at, _ in list(self.states) if at >= since] + [time.monotonic()]
        return max(b - a for a, b in zip(times, times[1:]))

    def losses(self):
        """Counters of lost frames, by name, as shown on the page."""
        counters = self.states[-1][1]["counters"]
        return {counter["name"]: counter["value"] for counter in counters if counter["is_loss"]}

    def close(self):
        try:
            self.socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        self.socket.close()


def shake_hands(connection, host, origin, path="/ws", upgrade=True):
    """Requests the page or its socket; returns the status and whatever came after the head."""
    key = base64.b64encode(os.urandom(16)).decode()
    lines = [f"GET {path} HTTP/1.1", f"Host: {host}"]
    if origin:
        lines.append(f"Origin: {origin}")
    if upgrade:
        lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", f"Sec-WebSocket-Key: {key}"]
    connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
    data = b""
    while b"\r\n\r\n" not in data:
        more = connection.recv(4096)
        if not more:
            return 0, b""
        data += more
    head, rest = data.split(b"\r\n\r\n", 1)
    return int(head.split()[1]), rest


def connect(port, timeout=10):
    return socket.create_connection(("127.0.0.1", port), timeout)


def open_descriptors(pid):
    return len(os.listdir(f"/proc/{pid}/fd"))


def serve(talk, most=None):
    """A socket that serves each client by `talk(connection, number)` in a thread; returns its port and a function that
    closes it."""
    listener = socket.create_server(("127.0.0.1", 0), backlog=64)
    ended = threading.Event()
    count = [0]

    def guest(connection, number):
        try:
            with connection:
                connection.settimeout(30)
                talk(connection, number, ended)
        except OSError:
            pass

    def accept():
        while not ended.is_set() and (most is None or count[0] < most):
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            count[0] += 1
            threading.Thread(target=guest, args=(connection, count[0]), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()

    def end():
        ended.set()
        listener.close()

    return listener.getsockname()[1], count, end
