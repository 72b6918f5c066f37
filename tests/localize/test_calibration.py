"""Calibration: the fit is the optimum it claims to be, and what it says comes true on cases like it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.errors import BenchmarkError
from salad.geo import GeoPoint, shifted
from salad.images.photo import Photo
from salad.index.index import Match
from salad.localize.calibration import (
    BINS,
    Case,
    Predictions,
    calibrate,
    calibration_error,
    fit_logistic,
    judge,
    log_loss,
    reliability,
    threshold,
)
from salad.network.config import Calibration

TOWN = GeoPoint(37.7, -122.4)
SIGNS = np.array([1, 1, -1, 1])


def drawn(seed: int, count: int = 200, *, weights: tuple[float, ...] = (3, 2, 2, 1)) -> tuple[np.ndarray, np.ndarray]:
    """Evidence `[count, 4]` and what is right, by a logistic model of these weights."""
    chance = np.random.default_rng(seed)
    evidence = chance.normal(size=(count, 4))
    z = (evidence * SIGNS) @ np.array(weights)
    return evidence, chance.random(count) < 1 / (1 + np.exp(-z))


def judged(sure: object, right: object, weight: object = None) -> Predictions:
    """As if all stood 1 m from a place of radius 1 m."""
    confidence, flags = np.asarray(sure, dtype=float), np.asarray(right, dtype=bool)
    ones = np.ones(len(flags))
    return Predictions(confidence, flags, ones, ones, ones if weight is None else np.asarray(weight, dtype=float))


def drawn_cases(seed: int, places: int = 40) -> list[Case]:
    """Queries of a city of 5 photos a place; every third place is not in the index, so its queries match at random."""
    chance = np.random.default_rng(seed)
    cases = []
    for number in range(places):
        home = shifted(TOWN, 300.0 * number, 0)
        for _ in range(4):
            here = 0 if number % 3 == 0 else int(chance.integers(1, 6))
            scores = np.sort(chance.normal(0.4, 0.05, 5) + (np.arange(5) < here) * chance.normal(0.25, 0.1))[::-1]
            where = [
                shifted(home, *chance.normal(0, 4, 2))
                if n < here
                else shifted(TOWN, 300.0 * chance.integers(places), 5000)
                for n in range(5)
            ]
            matches = [
                Match(Photo(Path(f"{n}.jpg"), point), float(score), n)
                for n, (point, score) in enumerate(zip(where, scores, strict=True))
            ]
            cases.append(Case(str(number), matches, shifted(home, *chance.normal(0, 4, 2))))
    return cases


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.lists(st.floats(-4, 4), min_size=4, max_size=4))
def test_the_fit_is_the_optimum_without_negative_weights(seed: int, weights: list[float]) -> None:
    evidence, right = drawn(seed, weights=tuple(weights))
    right[:2] = True, False
    weight = np.random.default_rng(seed).uniform(0.5, 1.5, len(right))
    weight /= weight.mean()
    bias, found = fit_logistic(evidence, right, 3 * weight)
    assert (found >= 0).all()
    # Karush, Kuhn and Tucker: no slope along what is free, none that would gain along what is held at 0.
    signed = evidence * SIGNS
    scale = signed.std(axis=0)
    sure = 1 / (1 + np.exp(-(bias + signed @ found)))
    slope = ((signed - signed.mean(axis=0)) / scale).T @ (weight * (sure - right)) + found * scale
    assert abs(weight @ (sure - right)) < 1e-3
    assert np.allclose(slope[found > 0], 0, atol=1e-8)
    assert (slope[found == 0] > -1e-8).all()


def test_the_fit_does_not_care_for_units() -> None:
    evidence, right = drawn(1)
    bias, weights = fit_logistic(evidence, right, np.ones(len(right)))
    scaled_bias, scaled = fit_logistic(evidence * [1, 10, 100, 0.1] + [5, 0, 0, 0], right, np.ones(len(right)))
    assert scaled * [1, 10, 100, 0.1] == pytest.approx(weights, rel=1e-5)
    assert scaled_bias + 5 * scaled[0] == pytest.approx(bias, abs=1e-5)


def test_evidence_that_never_varies_is_no_evidence() -> None:
    evidence, right = drawn(2)
    evidence[:, 3] = 1.0
    assert np.isfinite(fit_logistic(evidence, right, np.ones(len(right)))[1]).all()


def test_what_is_plain_to_see_is_fitted_too() -> None:
    evidence, _ = drawn(3)
    bias, weights = fit_logistic(
        evidence, evidence[:, 0] > 0.3, np.ones(200)
    )  # perfectly parted: without a pull to 0 there is no optimum
    assert np.isfinite([bias, *weights]).all()
    assert weights[0] > 2


@pytest.mark.parametrize("right", [True, False])
def test_where_nothing_is_wrong_or_nothing_right_there_is_nothing_to_fit(right: bool) -> None:
    with pytest.raises(BenchmarkError, match="some of both"):
        fit_logistic(drawn(0)[0], np.full(200, right), np.ones(200))


some_weight = st.sampled_from([0.25, 1.0, 2.0])


@given(
    st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.9, 1.0]), st.booleans(), some_weight), min_size=1),
    st.sampled_from([0.5, 0.875, 0.95]),
)
def test_the_threshold_is_the_lowest_that_keeps_its_word(cases: list[tuple[float, bool, float]], wanted: float) -> None:
    sure, right, weight = (np.array(column) for column in zip(*cases, strict=True))
    good = [
        limit for limit in set(sure) if (weight * right)[sure >= limit].sum() >= wanted * weight[sure >= limit].sum()
    ]
    found = threshold(judged(sure, right, weight), wanted)
    assert found == (min(good) if good else sure.max())


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans(), some_weight), min_size=1))
def test_every_case_is_in_one_step(cases: list[tuple[float, bool, float]]) -> None:
    told = judged(*zip(*cases, strict=True))
    steps = reliability(told)
    assert len(steps) == BINS
    assert sum(one.cases for one in steps if one) == len(cases)
    assert sum(one.weight for one in steps if one) == pytest.approx(1)
    for number, one in enumerate(steps):
        assert one is None or number / BINS - 1e-9 <= one.confidence <= (number + 1) / BINS + 1e-9
    assert 0 <= calibration_error(told) <= 1


def test_calibration_error_of_what_is_known() -> None:
    right = np.array([True, True, True, False])
    assert calibration_error(judged(np.full(4, 0.75), right)) == 0
    assert calibration_error(judged(np.full(4, 0.95), right)) == pytest.approx(0.2)
    assert calibration_error(judged(np.full(4, 0.5), right, [1, 1, 1, 3])) == pytest.approx(0)
    assert calibration_error(judged(right, right)) == 0
    assert calibration_error(judged(~right, right)) == 1
    assert log_loss(judged(right, right)) == 0
    assert log_loss(judged(np.full(4, 0.5), right)) == pytest.approx(np.log(2))


def test_a_weight_of_two_is_the_case_twice() -> None:
    evidence, right = drawn(7)
    heavy = fit_logistic(evidence, right, np.r_[np.full(100, 2.0), np.ones(100)])
    twice = fit_logistic(np.r_[evidence, evidence[:100]], np.r_[right, right[:100]], np.ones(300))
    # Near, but for the pull to 0 and the scale of the evidence, which know of counts alone.
    assert heavy[0] == pytest.approx(twice[0], abs=0.1)
    assert heavy[1] == pytest.approx(twice[1], rel=0.05, abs=0.05)


def test_a_calibration_keeps_its_word_on_other_cases_like_it() -> None:
    calibration, out_of_fold = calibrate(drawn_cases(0, 60), provenance="drawn")
    assert calibration.provenance == "drawn"
    assert Calibration.from_dict(calibration.as_dict()) == calibration
    assert calibration_error(out_of_fold) < 0.1
    new = judge(drawn_cases(1, 60), calibration)
    answered = new.confidence >= calibration.min_confidence
    assert calibration_error(new) < 0.1
    assert answered.mean() > 0.3
    assert new.right[answered].mean() > 0.9
    assert (new.error_m <= new.radius_m)[answered].mean() == pytest.approx(0.9, abs=0.07)


def test_the_order_of_cases_does_not_matter_nor_does_chance() -> None:
    cases = drawn_cases(5)
    one, other = (calibrate(some)[0] for some in (cases, cases[::-1]))
    for name, value in one.as_dict().items():
        assert value == pytest.approx(other.as_dict()[name], abs=2e-4) or isinstance(value, str)
    assert calibrate(cases)[0] == one


def test_photos_from_nowhere_near_are_never_right() -> None:
    cases = drawn_cases(2)
    calibration, _ = calibrate(cases)
    far = judge([replace(case, truth=None) for case in cases], calibration)
    assert not far.right.any()
    assert np.isinf(far.error_m).all()


def test_too_few_places_or_no_position_is_refused() -> None:
    cases = drawn_cases(0)
    with pytest.raises(BenchmarkError, match="at least 5"):
        calibrate(cases[:16])
    nowhere = Case("x", [Match(Photo(Path("a.jpg")), 0.9, 0)], TOWN)
    with pytest.raises(BenchmarkError, match="no photo with a position"):
        calibrate([*cases, nowhere])
