"""Cache, queues and engine together against a plain model of what clients see and what they may be shown."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from luxel.dynamic.entries import ESTIMATE, FAILED, FULL, NONE, QUEUED, grade_of, work_of
from luxel.dynamic.sightings import shard_of
from luxel.light.in_view import Gaze

from .fakes import Clock, FakeBaker, Stage, code_of

# Four shards with a slot each for textures that replace others; tables of six light keys fit.
COUNT, CAPACITY, TEXELS = 160, 132, 16
RING = np.random.default_rng(0).permutation(COUNT)
EXPIRY_S = 2.0
NAMES = tuple("abcdefgh")
KEYS = st.sampled_from(NAMES)
CLIENTS = st.sampled_from(["ann", "bob"])
# What a camera sees: a window of a ring on which the particles lie.
IDS = st.builds(
    lambda first, width: {int(RING[(first + k) % COUNT]) for k in range(width)},
    st.integers(0, COUNT - 1),
    st.integers(0, COUNT - 10),
)
EVENTS = st.sampled_from(["relight", "look", "leave", "frame", "storm"])
EVERY = np.arange(COUNT, dtype=np.int32)


class Baker(FakeBaker):
    """Lets something happen while it works."""

    def __init__(self, meanwhile, *args, **options) -> None:
        super().__init__(*args, **options)
        self.meanwhile = meanwhile

    def first_light(self, ids: np.ndarray) -> np.ndarray:
        self.meanwhile()
        return super().first_light(ids)

    def bake_into(self, ids: np.ndarray, codes: np.ndarray, gaze: Gaze | None = None) -> int:
        self.meanwhile()
        return super().bake_into(ids, codes, gaze)


class DynamicMachine(RuleBasedStateMachine):
    """Model: the latest sighting of every client, when each was made, and which textures there were after the last step."""

    @initialize(
        shards=st.sampled_from([1, 4]),
        estimates=st.booleans(),
        texture_s=st.sampled_from([0, 0.004]),
    )
    def start(self, shards, estimates, texture_s):
        self.shards = shards
        clock = Clock()
        self.stage = Stage(
            count=COUNT, capacity=CAPACITY, clock=clock, shards=shards, estimates=estimates, texels=TEXELS
        )
        for key in NAMES:
            self.stage.bakers[key] = Baker(self.meanwhile, key, clock, texture_s)
            self.stage.estimators[key] = Baker(self.meanwhile, key, clock, texture_s, grade=ESTIMATE)
        self.cache, self.engine, self.clock = self.stage.cache, self.stage.engine, clock
        self.sightings: dict[str, tuple[str, set[int]]] = {}
        self.sighted_s: dict[str, float] = {}  # client -> when
        self.asked: dict[tuple[str, int], float] = {}  # (client, particle) -> when it was sighted last
        self.frames: list[tuple[object, dict[int, int], dict[int, float]]] = []
        self.wrong: list[str] = []
        self.event = (10**9, lambda: None)
        # (client, particle): made, but frames held every slot that was free: to be sighted again by this client.
        self.dropped: set[tuple[str, int]] = set()
        self.engine.subscribe(self.hear)
        self.engine.subscribe_coarse(self.hear_coarse)
        self.lights: list[str] = []
        self.current = ""
        self.relight("a")

    # What goes on.

    @rule(client=CLIENTS, ids=IDS, far=st.integers(0, 3), wait_s=st.sampled_from([0.0, 0.1, 1.0]))
    def look(self, client, ids, far, wait_s):
        """Move a camera."""
        self.clock.now_s += wait_s
        self.sight(client, self.current, ids, far)

    @rule(client=CLIENTS, key=KEYS, ids=IDS)
    def look_late(self, client, key, ids):
        """Tell what was seen under a light that may have gone."""
        self.sight(client, key, ids, 0)

    @rule(client=CLIENTS)
    def leave(self, client):
        self.engine.forget(client)
        self.sightings.pop(client, None)
        self.asked = {entry: at for entry, at in self.asked.items() if entry[0] != client}
        self.dropped = {entry for entry in self.dropped if entry[0] != client}

    @rule(key=KEYS)
    def relight(self, key):
        if key == self.current:
            return
        self.stage.select(key)
        self.lights = [each for each in self.lights if each != key and self.cache.light(each)] + [key]
        self.current = key
        # All requests are withdrawn. What was sighted under this light before is in sight again, since when it was sighted.
        self.asked = {
            (client, each): self.sighted_s[client]
            for client, (under, ids) in self.sightings.items()
            if under == key
            for each in ids
        }
        self.dropped.clear()

    @rule(wait_s=st.sampled_from([0.5, 2.5]))
    def rest(self, wait_s):
        self.clock.now_s += wait_s

    @rule(pieces=st.integers(1, 12))
    def work(self, pieces):
        with self.watched():
            for _ in range(pieces):
                self.engine.run_once()

    @rule(budget_s=st.sampled_from([0.002, 0.033]))
    def draw(self, budget_s):
        """Draw a frame that is held until two more are drawn, and bake for a while."""
        self.hold()
        with self.watched():
            self.engine.run_for(budget_s)

    @rule(bad=st.sets(st.sampled_from(RING[:40:15].tolist())))
    def fail(self, bad):
        """Have workers fail for some particles from now on."""
        for baker in (*self.stage.bakers.values(), *self.stage.estimators.values()):
            baker.bad = bad

    @rule(event=EVENTS, after=st.integers(0, 5), key=KEYS, client=CLIENTS, ids=IDS)
    def interrupt(self, event, after, key, client, ids):
        """Have something happen while a worker is busy with the next piece but some."""
        calls = {
            "relight": lambda: self.relight(key),
            "storm": lambda: [self.relight(each) for each in (*NAMES, key)],
            "look": lambda: self.sight(client, self.current, ids, 0),
            "leave": lambda: self.leave(client),
            "frame": self.hold,
        }
        self.event = (after, calls[event])

    def meanwhile(self):
        after, call = self.event
        self.event = (after - 1, call) if after else (10**9, call)
        if not after:
            call()

    @rule()
    def drop_frames(self):
        self.frames = []

    @rule(client=CLIENTS, ids=IDS, held=st.booleans())
    def visit(self, client, ids, held):
        """Move a camera and wait there."""
        if held:
            self.hold()
        self.sight(client, self.current, ids, 0)
        self.finish(held)

    @rule()
    def finish(self, held=False):
        """At rest, everything in sight has its texture, unless its worker failed twice or there is no room."""
        if not held:
            self.frames = []
        if self.dropped:
            for client, (key, ids) in self.sightings.items():
                self.sight(client, key, ids, 0)
        with self.watched():
            for _ in range(400):
                if not self.engine.run_once():
                    break
            else:
                raise AssertionError("work never ends")
        self.engine.settle()
        light = self.cache.light(self.current)
        visible = self.visible()
        failed = set(EVERY[work_of(light.state) == FAILED].tolist())
        assert failed <= set(RING[:40:15].tolist())
        counts = self.cache.counts(self.current)
        assert counts.baking == 0
        if self.frames:  # which may hold every slot that is not on the screen
            return
        assert counts.queued == counts.refining == 0
        lacking = {each for each in visible - failed if grade_of(light.state)[each] < FULL}
        assert len(lacking) == self.engine.over_budget
        for shard in self.cache.shards:
            if any(shard_of(EVERY, self.shards)[each] == shard.number for each in lacking):
                assert shard.room() == 0

    # What always holds.

    @invariant()
    def what_is_shown_as_current_is_current(self):
        for key in self.lights:
            table = self.cache.snapshot(key)
            grades = grade_of(self.cache.light(key).state)
            there = EVERY[table.slot >= 0]
            textures = table.codes[table.slot[there]].reshape(len(there), TEXELS**2).T
            full = (textures == code_of(key, there)).all(axis=0)
            assert (full | (textures == code_of(key, there, ESTIMATE)).all(axis=0)).all()
            if not self.frames:  # as long as they are held, they may be all that there is
                assert ((table.slot >= 0) == (grades != NONE)).all()
                assert (full == (grades[there] == FULL)).all()
            if key != self.current:
                assert not len(table.coarse)
        assert not self.stage.wrong
        assert not self.wrong

    @invariant()
    def frames_that_are_held_do_not_change(self):
        for table, codes, records in self.frames:
            for each, code in codes.items():
                assert (table.codes[table.slot[each]] == code).all()
            for each, record in records.items():
                assert table.coarse[each, 0] == record

    @invariant()
    def the_budget_is_kept(self):
        stats = self.cache.stats()
        held = sum(len(self.held(key)) for key in self.lights)
        assert held == stats.textures == stats.ready - stats.evicted <= self.cache.capacity
        arena = self.cache._arena
        nbytes = sum(getattr(arena, name).nbytes for name in ("codes", "light", "owner", "seen"))
        for key in self.lights:
            light = self.cache.light(key)
            nbytes += light.state.nbytes + light.table.nbytes + light.coarse.nbytes
        assert nbytes <= self.cache.max_bytes
        assert stats.nbytes <= nbytes

    @invariant()
    def what_lacks_a_texture_is_requested_as_long_as_it_is_in_sight(self):
        self.engine.settle()
        state = self.cache.light(self.current).state
        visible = self.visible()
        queued = set(EVERY[work_of(state) == QUEUED].tolist())
        desks = self.engine._baking.desks
        again = {particle for desk in desks for _, particle in desk._again}
        again |= {particle for desk in desks for ids in desk._left.values() for particle in ids.tolist()}
        failed = set(EVERY[work_of(state) == FAILED].tolist())
        lacking = {each for each in visible if grade_of(state)[each] == NONE}
        asking = {
            each
            for client, (key, ids) in self.sightings.items()
            for each in ids
            if key == self.current and (client, each) not in self.dropped
        }
        assert len((lacking & asking) - queued - again - failed) <= self.engine.over_budget
        recent = {
            particle
            for (_, particle), at in self.asked.items()
            if self.clock.now_s - at < EXPIRY_S  # what was never taken in may have lapsed unseen
        }
        assert queued <= visible | recent
        for key in self.lights:
            if key != self.current:
                counts = self.cache.counts(key)
                assert counts.queued == counts.baking == counts.refining == 0

    def teardown(self):
        if hasattr(self, "engine"):
            self.engine.close()

    # How it is done.

    def sight(self, client, key, ids, far):
        ids = np.array(sorted(ids), np.int32)
        known = self.sightings.get(client)
        self.stage.request(key, ids, far + 0.01 * ids, client)
        if key != self.current:
            assert self.sightings.get(client) == known
            return
        now = self.clock.now_s
        self.sightings[client], self.sighted_s[client] = (key, set(ids.tolist())), now
        self.asked.update({(client, each): now for each in ids.tolist()})
        self.dropped = {entry for entry in self.dropped if entry[0] != client}

    def hold(self):
        table = self.cache.snapshot(self.current)
        if any(table.slot is held.slot for held, _, _ in self.frames):
            return  # none has changed, or as many are held as there may be
        codes = {
            int(each): int(table.codes[table.slot[each]][0, 0]) for each in np.flatnonzero(table.slot >= 0)
        }
        lit, records = self.cache.lookup_coarse(self.current, EVERY)
        first = dict(zip(EVERY[lit].tolist(), records[:, 0].tolist(), strict=True))
        self.frames = [*self.frames[-1:], (table, codes, first)]

    def visible(self):
        return set().union(*(ids for key, ids in self.sightings.values() if key == self.current))

    def held(self, key):
        return set(EVERY[self.cache.lookup(key, EVERY)[0]].tolist())

    def seen(self):
        """What the latest sighting of some client shows; light keys that were given up and begun again are others."""
        lights = {key: self.cache.light(key) for key in self.lights}
        return {
            (lights[key].number, each)
            for key, ids in self.sightings.values()
            if lights.get(key) is not None
            for each in ids
        }

    def textures(self):
        lights = [self.cache.light(key) for key in self.lights]
        return {(light.number, each) for light in lights if light for each in self.held(light.key)}

    def watched(self):
        return _Watched(self)

    def hear(self, batch):
        if batch.stale != (batch.key != self.current):
            self.wrong.append(batch.key)  # an assertion would be taken for a listener that fails
        if not batch.stale:
            there = self.cache.lookup(batch.key, batch.ids)[0]
            lost = set(batch.ids[~there].tolist())
            self.dropped |= {
                (client, each) for client, (_, ids) in self.sightings.items() for each in lost & ids
            }

    def hear_coarse(self, batch):
        if batch.key != self.current:
            self.wrong.append(batch.key)


class _Watched:
    """Nothing is evicted that some client's latest frame shows, and showed before."""

    def __init__(self, machine):
        self.machine = machine

    def __enter__(self):
        self.before = self.machine.seen() & self.machine.textures()

    def __exit__(self, kind, error, trace):
        if kind is None:
            assert self.before & self.machine.seen() <= self.machine.textures()


DynamicMachine.TestCase.settings = settings(
    max_examples=100, stateful_step_count=40, deadline=None, derandomize=True
)
TestDynamicMachine = DynamicMachine.TestCase
