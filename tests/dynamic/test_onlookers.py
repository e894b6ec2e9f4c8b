"""Who looks from where: estimates are told, and textures never are."""

import numpy as np
import pytest

import luxel
from luxel.session import Session
from luxel.textures.bake import Baker
from luxel.textures.estimate import EstimateBaker
from luxel.textures.spec import TextureSpec
from tests.dynamic.fakes import Stage
from tests.scenes import lattice

HERE, THERE = np.array([1, 2, 3], np.float32), np.array([-4, 0, 9], np.float32)


@pytest.fixture
def stage():
    stage = Stage(estimates=True)
    stage.select("a")
    yield stage
    stage.engine.close()


def gazes(stage, key="a"):
    """What each batch of estimates was told, in order."""
    return stage.estimators[key].gazes


def test_estimates_are_told_who_looks_and_what_is_shown(stage):
    stage.request("a", [3, 5, 900], eye=HERE)
    stage.engine.wait()
    assert gazes(stage)
    for gaze in gazes(stage):
        np.testing.assert_array_equal(gaze.eyes, [HERE])
        assert np.flatnonzero(gaze.shown).tolist() == [3, 5, 900]
        assert len(gaze.shown) == stage.count
    assert set(stage.bakers["a"].gazes) == {None}
    np.testing.assert_array_equal(stage.estimators["a"].prepared_for.eyes, [HERE])
    assert stage.bakers["a"].prepared_for is None


def test_estimates_are_prepared_anew_for_pictures_that_they_do_not_suit(stage):
    def prepared():
        return [what for what, _ in stage.estimators["a"].work if what == "prepare"]

    stage.request("a", [3, 5], eye=HERE)
    stage.engine.wait()
    stage.estimators["a"].unsuitable = {8}
    stage.request("a", [3, 5, 7], eye=HERE)
    stage.engine.wait()
    assert len(prepared()) == 1
    stage.request("a", [8], eye=THERE)
    stage.engine.wait()
    stage.request("a", [8, 9], eye=THERE)  # the first piece was still made as before
    stage.engine.wait()
    assert len(prepared()) == 2
    np.testing.assert_array_equal(stage.estimators["a"].prepared_for.eyes, [THERE])
    stage.request("a", [8, 10], eye=THERE)
    stage.engine.wait()
    assert len(prepared()) == 2
    assert {8, 9, 10} <= set(np.concatenate(stage.estimators["a"].batches).tolist())


def test_what_is_not_in_sight_any_more_is_not_shown(stage):
    stage.request("a", [3, 5], eye=HERE)
    stage.engine.wait()
    stage.request("a", [5, 6], eye=THERE)
    stage.engine.wait()
    np.testing.assert_array_equal(gazes(stage)[-1].eyes, [THERE])
    assert np.flatnonzero(gazes(stage)[-1].shown).tolist() == [5, 6]


def test_all_who_look_count_until_they_are_forgotten(stage):
    stage.request("a", [3], eye=HERE, client="one")
    stage.request("a", [4], eye=THERE, client="two")
    stage.engine.wait()
    gaze = gazes(stage)[-1]
    assert sorted(map(tuple, gaze.eyes)) == sorted(map(tuple, (HERE, THERE)))
    assert np.flatnonzero(gaze.shown).tolist() == [3, 4]
    stage.engine.forget("one")
    stage.request("a", [7], eye=THERE, client="two")
    stage.engine.wait()
    assert np.flatnonzero(gazes(stage)[-1].shown).tolist() == [7]
    np.testing.assert_array_equal(gazes(stage)[-1].eyes, [THERE])


def test_where_somebody_does_not_say_from_where_or_many_look_estimates_are_whole(stage):
    stage.request("a", [3], eye=HERE, client="one")
    stage.request("a", [4], client="two")
    stage.engine.wait()
    assert gazes(stage)[-1] is None
    stage.engine.forget("two")
    for k in range(5):
        stage.request("a", [10 + k], eye=HERE + k, client=f"page {k}")
    stage.engine.wait()
    assert gazes(stage)[-1] is None


def test_another_time_step_may_have_more_particles(stage):
    stage.request("a", [3, 999], eye=HERE)
    stage.engine.wait()
    stage.count = 1500
    stage.select("b")
    stage.request("b", [4, 1400], eye=HERE)
    stage.engine.wait()
    assert len(gazes(stage, "b")[-1].shown) == 1500
    assert np.flatnonzero(gazes(stage, "b")[-1].shown).tolist() == [4, 1400]


@pytest.mark.parametrize("how", [{"engine": {"small_pixels": 6.0}}, {"components": 2}])
def test_estimates_that_stay_or_that_a_basis_is_learnt_from_are_whole(how):
    stage = Stage(estimates=True, **how)
    stage.select("a")
    stage.request("a", [3, 5], pixels=[2.0, 30.0], eye=HERE)
    stage.engine.wait()
    assert gazes(stage)
    assert set(gazes(stage)) == {None}
    assert stage.estimators["a"].prepared_for is None
    stage.engine.close()


def test_each_light_has_its_own_onlookers(stage):
    stage.request("a", [3], eye=HERE, client="one")
    stage.engine.wait()
    stage.select("b")
    stage.request("b", [3, 8], eye=THERE, client="two")
    stage.engine.wait()
    np.testing.assert_array_equal(gazes(stage, "b")[-1].eyes, [THERE])
    assert np.flatnonzero(gazes(stage, "b")[-1].shown).tolist() == [3, 8]


def test_a_session_samples_what_is_looked_at_first_and_ends_with_whole_textures():
    particles = lattice(5)
    spec = TextureSpec(mode="fast", samples=4)
    ids = np.arange(len(particles), dtype=np.int32)
    with Session(particles, spec=spec, threads=0) as session:
        first: dict[int, np.ndarray] = {}
        session.subscribe(
            lambda batch: first.update(
                {
                    int(i): codes
                    for i, codes, early in zip(batch.ids, batch.codes, batch.estimate, strict=True)
                    if early
                }
            )
        )
        session.sighted(ids, (9.0, 1.0, 3.0))
        assert session.wait()
        assert sorted(first) == ids.tolist()
        whole = np.empty((len(ids), 16, 16), np.uint8)
        EstimateBaker(Baker(session.scene, spec), whole=True).bake_into(ids, whole)
        alike = np.array([np.array_equal(first[i], whole[i]) for i in ids])
        assert alike.mean() < 0.5  # what faces away was guessed
        expected = luxel.bake(session.scene, ids, samples=4, mode="fast")
        np.testing.assert_array_equal(session.tiles(ids).codes, expected.codes)
