"""Pictures of what the model saw."""

import base64
import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.errors import ModelError
from salad.models.describer import Describer, TokenAssignment
from salad.models.fake import FakeDescriber
from salad.network.aggregator_config import SaladConfig
from salad.network.config import ModelConfig
from salad.network.network import build
from salad.report import explain

GREY = (90, 100, 110)


def share(dustbin: Any, cluster: Any = None) -> TokenAssignment:
    took = np.asarray(dustbin, dtype=np.float32)
    return TokenAssignment(took, np.zeros(took.shape, dtype=np.int64) if cluster is None else np.asarray(cluster))


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(1, 7),
    columns=st.integers(1, 7),
    scale=st.integers(2, 9),
    stretch=st.integers(1, 3),
    data=st.data(),
)
def test_one_token_colours_its_own_region_and_nothing_else(
    rows: int, columns: int, scale: int, stretch: int, data: st.DataObject
) -> None:
    row, column = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))
    took = np.zeros((rows, columns))
    took[row, column] = 1
    high, wide = scale * stretch, scale  # a squeezed photo's tokens are not square
    photo = Image.new("RGB", (columns * wide, rows * high), GREY)
    changed = (np.asarray(explain.dustbin_over(photo, share(took))) != GREY).any(axis=-1)
    expected = np.zeros_like(changed)
    expected[row * high : (row + 1) * high, column * wide : (column + 1) * wide] = True
    assert (changed == expected).all()


def test_heat_rises_with_the_share_and_halves_at_the_mean() -> None:
    took = np.linspace(0.8, 1.0, 20).reshape(4, 5)
    heats = explain.heat(share(took)).ravel()
    assert (np.diff(heats) > 0).all()
    assert np.interp(took.mean(), took.ravel(), heats) == pytest.approx(0.5, abs=0.02)
    assert explain.heat(share([[0.0, 1.0]])).tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("value", [0.0, 1.0, 0.5, 1.0000001, -1e-7])
def test_heat_of_an_even_share_is_finite_and_within_bounds(value: float) -> None:
    heats = explain.heat(share(np.full((2, 3), value)))
    assert ((heats >= 0) & (heats <= 1)).all()


def test_more_heat_covers_more() -> None:
    alpha = np.asarray(explain.dustbin_layer(share([np.linspace(0, 1, 30)])))[0, :, 3].astype(int)
    assert (np.diff(alpha) >= 0).all()
    assert alpha[0] == 0
    assert alpha[-1] > 180


def test_a_cluster_has_one_colour_in_every_photo_and_others_have_others() -> None:
    one = np.asarray(explain.cluster_layer(share(np.full((1, 3), 0.5), [[4, 9, 4]])))[0]
    two = np.asarray(explain.cluster_layer(share(np.full((1, 2), 0.1), [[9, 31]])))[0]
    assert (one[0] == one[2]).all()
    assert (one[1, :3] == two[0, :3]).all()
    assert len({explain.cluster_colour(number) for number in range(64)}) == 64


def test_a_cluster_is_faint_where_the_dustbin_took_most() -> None:
    alpha = np.asarray(explain.cluster_layer(share([[0.1, 0.9]])))[0, :, 3]
    assert alpha[0] > alpha[1] > 0


def test_clusters_lie_over_the_photo_where_their_tokens_are() -> None:
    photo = Image.new("RGB", (8, 4), GREY)
    drawn = np.asarray(explain.clusters_over(photo, share([[0.5, 0.5]], [[1, 2]])))
    assert (drawn[:, :4] == drawn[0, 0]).all()
    assert (drawn[:, 4:] == drawn[0, 7]).all()
    assert (drawn[0, 0] != drawn[0, 7]).any()


def test_only_a_model_with_a_dustbin_shares() -> None:
    photo = Image.effect_noise((64, 64), 40).convert("RGB")

    class Pooled(FakeDescriber):
        def token_assignment(self, photo: object) -> TokenAssignment:
            raise ModelError("the model has no dustbin")

    assert explain.share_of(FakeDescriber(), photo) is None
    assert explain.share_of(Pooled(), photo) is None


def test_a_real_head_shares_a_value_for_each_token() -> None:
    from salad.training.recipe import PRESETS

    config: ModelConfig = PRESETS["salad-lite"].model
    assert isinstance(config.aggregator, SaladConfig)
    found = explain.share_of(Describer.of(build(config)), Image.effect_noise((90, 60), 60).convert("RGB"))
    assert found is not None
    assert found.dustbin.shape == found.cluster.shape == (20, 20)
    assert explain.dustbin_layer(found).size == (20, 20)


# --- strips --------------------------------------------------------------------------------


def test_a_strip_shows_every_picture_at_one_height_in_its_own_shape() -> None:
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200)]
    sizes = [(80, 60), (60, 60), (30, 60)]
    query, *references = (Image.new("RGB", size, colour) for size, colour in zip(sizes, colours, strict=True))
    strip = np.asarray(explain.match_strip(query, references, height=60))
    for colour, (width, _) in zip(colours, sizes, strict=True):
        across = (strip == colour).all(axis=-1).any(axis=0).sum()
        assert width - 2 * 2 <= across <= width  # a reference's frame lies on its edge
    red, green = (np.flatnonzero((strip == colour).all(axis=-1).any(axis=0)) for colour in colours[:2])
    assert red.max() < green.min()


@pytest.mark.parametrize(("right", "colour"), [(True, explain.RIGHT), (False, explain.WRONG), (None, explain.PLAIN)])
def test_a_frame_says_whether_a_reference_is_right(right: bool | None, colour: tuple[int, int, int]) -> None:
    white = Image.new("RGB", (40, 40), "white")
    strip = np.asarray(explain.match_strip(white, [white], right=[right], height=40))
    assert (strip == colour).all(axis=-1).any()
    unsaid = np.asarray(explain.match_strip(white, [white], height=40))
    assert (unsaid == explain.PLAIN).all(axis=-1).any()


def test_captions_make_room_and_never_run_into_the_next() -> None:
    white = Image.new("RGB", (60, 60), "white")
    bare = explain.match_strip(white, [white], height=60)
    said = explain.match_strip(white, [white], captions=["a query with a very long name\nand a break"], height=60)
    assert said.height > bare.height
    assert said.width == bare.width
    below = np.asarray(said)[66:]
    assert (below < 128).any()
    assert (below[:, 68:] > 250).all()


def test_a_strip_without_references_or_room() -> None:
    white = Image.new("RGB", (60, 60), "white")
    assert explain.match_strip(white, []).size[1] >= 240
    assert explain.match_strip(white, [white], captions=["", "x" * 99, "more"], height=16).height > 16
    with pytest.raises(ModelError, match="height of 16"):
        explain.match_strip(white, [], height=3)


def test_a_picture_in_a_line_of_text_is_the_picture() -> None:
    noise = Image.effect_noise((30, 20), 50)
    kind, data = explain.data_uri(noise).split(",")
    assert kind == "data:image/jpeg;base64"
    assert Image.open(io.BytesIO(base64.b64decode(data))).size == (30, 20)
    layer = explain.dustbin_layer(share([[0, 0.3], [0.7, 1]]))
    kind, data = explain.data_uri(layer).split(",")
    assert kind == "data:image/png;base64"
    assert (np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA")) == np.asarray(layer)).all()
