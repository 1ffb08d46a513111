"""A session under random sequences of all its operations: it keeps running and its counts add up."""

import gc
import os
import urllib.request

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

import dermis

NUMBERS = st.one_of(
    st.floats(-60, 60), st.floats(), st.integers(-(2**70), 2**70), st.none(), st.text(max_size=3), st.booleans()
)
# Python's own exceptions for arguments of the wrong type.
REFUSED = (dermis.Error, TypeError, OverflowError, ValueError)


class Sessions(RuleBasedStateMachine):
    """One session at a time, open or closed, and the facts known about it."""

    def __init__(self):
        super().__init__()
        self.session = None

    @initialize(name=st.sampled_from(["ionic-disc", "em-8", "hydrogel-disc"]))
    def begins(self, name):
        self.opens(name)

    @rule(name=st.sampled_from(["ionic-disc", "healing-square"]))
    def opens_another(self, name):
        self.opens(name)

    def opens(self, name):
        if self.session is not None:
            self.session.close()
        self.session = dermis.open(f"twin:{name}")
        self.seen, self.last, self.is_open, self.page = 0, None, True, None
        self.there, self.gone = set(), set()
        # Pixels that lie on the skin.
        self.inside = None

    @precondition(lambda self: self.is_open)
    @rule(count=st.integers(1, 50))
    def takes_frames(self, count):
        for _ in range(count):
            result = next(self.session)
            assert self.last is None or result.sequence > self.last
            self.last = result.sequence
            self.seen += 1
            touches = result.touches
            assert len(set(touches["id"])) == len(touches)
            assert np.isfinite(touches["x_mm"]).all() and np.isfinite(touches["y_mm"]).all()
            # A touch that has ended does not come back.
            self.gone |= self.there - set(touches["id"])
            self.there = set(touches["id"])
            assert not self.there & self.gone
        assert result.ready or not np.isfinite(result.image).any()
        finite = int(np.isfinite(result.image).sum())
        if finite and self.inside is None:
            self.inside = finite
        assert finite in (0, self.inside)

    @precondition(lambda self: self.is_open)
    @rule(numbers=st.lists(NUMBERS, max_size=4), named=st.dictionaries(st.sampled_from(["pressure_kpa", "pointer"]), NUMBERS))
    def presses(self, numbers, named):
        self.asks(lambda: self.session.press(*numbers, **named))

    @precondition(lambda self: self.is_open)
    @rule(numbers=st.lists(NUMBERS, max_size=1))
    def releases(self, numbers):
        self.asks(lambda: self.session.release(*numbers))

    @precondition(lambda self: self.is_open)
    @rule(force=st.booleans())
    def tares(self, force):
        self.asks(lambda: self.session.tare(force=force))

    @precondition(lambda self: self.is_open)
    @rule(number=st.one_of(NUMBERS, st.floats(1e-6, 1e3)))
    def changes_the_hyperparameter(self, number):
        self.asks(lambda: self.session.set_hyperparameter(number))

    @precondition(lambda self: self.is_open and self.page is None)
    @rule()
    def shows_a_page(self):
        self.page = self.session.show(browser=False)

    @precondition(lambda self: self.is_open and self.page is not None)
    @rule()
    def loads_the_page(self):
        with urllib.request.urlopen(self.page, timeout=60) as answer:
            assert answer.status == 200

    @rule()
    def closes(self):
        self.session.close()
        self.is_open, self.page = False, None

    @precondition(lambda self: not self.is_open)
    @rule(call=st.sampled_from([next, dermis.Session.tare, lambda s: s.press(0, 0), lambda s: s.counters, lambda s: s.show()]))
    def is_used_after_its_end(self, call):
        try:
            call(self.session)
        except (dermis.Error, StopIteration, ValueError):
            return
        raise AssertionError("a closed session answered")

    @rule()
    def collects(self):
        gc.collect()

    @invariant()
    def counts_add_up(self):
        if self.session is not None and self.is_open:
            counters = self.session.counters
            assert counters["frames"] == self.seen
            assert counters["lost"] == counters["damaged"] == 0
        if self.session is not None:
            assert self.session.closed is not self.is_open

    def asks(self, call):
        try:
            call()
        except REFUSED:
            pass

    def teardown(self):
        if self.session is not None:
            self.session.close()


# The same sequences in every test run on a clean clone, but random ones when run by hand.
TestSessions = Sessions.TestCase
TestSessions.settings = settings(
    deadline=None,
    max_examples=int(os.environ.get("DERMIS_FUZZ", "6")),
    stateful_step_count=30,
    suppress_health_check=list(HealthCheck),
    derandomize="CI" in os.environ,
    database=None,
)
