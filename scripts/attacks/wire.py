"""A minimal host for the wire: requests frames and counts them (docs/src/wire.md)."""

import struct
import threading
import time

from .tools import check

# The test vectors `hello` and `start` from the chapter on the wire.
HELLO = bytes.fromhex("000d01117856341201 0175e4f43600".replace(" ", ""))
START = bytes.fromhex("00040112070206 05db2933ab00".replace(" ", ""))


def unstuffed(packet):
    """Decodes COBS."""
    out, at = bytearray(), 0
    while at < len(packet):
        code = packet[at]
        out += packet[at + 1 : at + code]
        at += code
        if code < 255 and at < len(packet):
            out.append(0)
    return bytes(out)


class Host(threading.Thread):
    """Reads frames in a thread; `slow` waits between reads."""

    def __init__(self, connection, slow=0.0):
        super().__init__(daemon=True)
        self.connection = connection
        self.slow = slow
        self.times = []
        self.missing = 0
        self.last = None
        self.ended = False

    def run(self):
        rest = b""
        try:
            self.connection.sendall(HELLO)
            time.sleep(0.2)
            self.connection.sendall(START)
            while True:
                data = self.connection.recv(65536)
                if not data:
                    break
                *packets, rest = (rest + data).split(b"\0")
                for packet in packets:
                    if packet:
                        self._take(unstuffed(packet))
                time.sleep(self.slow)
        except OSError:
            pass
        self.ended = True

    def _take(self, packet):
        if len(packet) > 10 and packet[1] == 3:
            (sequence,) = struct.unpack_from("<I", packet, 2)
            if self.last is not None:
                self.missing += sequence - self.last - 1
            self.last = sequence
            self.times.append(time.monotonic())

    def wait_for_frames(self, count, timeout=30):
        end = time.monotonic() + timeout
        while len(self.times) < count:
            check(time.monotonic() < end and not self.ended, f"{len(self.times)} frames of {count} came in {timeout} s")
            time.sleep(0.02)

    def gap(self, since):
        """The longest time without a frame since a moment."""
        times = [since] + [at for at in list(self.times) if at >= since] + [time.monotonic()]
        return max(b - a for a, b in zip(times, times[1:]))
