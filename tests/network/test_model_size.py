"""How large models are: counted by hand for each aggregator, and the table that the documents show."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn

from salad.network.backbones.dinov2 import ViT
from salad.network.config import VITS
from salad.network.model_size import parameters, size_of, table


def _linear(inside: int, out: int) -> int:
    return inside * out + out


def _salad(d: int, m: int, l: int, g: int, hidden: int) -> int:  # noqa: E741  # the paper's letters
    return 3 * _linear(d, hidden) + _linear(hidden, m) + _linear(hidden, l) + _linear(hidden, g) + 1


def _boq(d: int, c: int, queries: int, rows: int) -> int:
    attention, norm = 4 * _linear(c, c), 2 * c
    encoder = attention + 2 * norm + _linear(c, 4 * c) + _linear(4 * c, c)
    block = encoder + queries * c + 2 * (attention + norm)
    return _linear(d, c) + norm + 2 * block + _linear(2 * queries, rows)


BY_HAND = {
    ("salad", 768): (_salad(768, 64, 128, 256, 512), 8448),
    ("salad", 112): (_salad(112, 64, 32, 128, 256), 2176),
    ("netvlad", 768): (32 * 768 + _linear(768, 32), 24576),
    ("gem", 768): (1, 768),
    ("average", 112): (0, 112),
    ("class-token", 112): (0, 112),
    ("mixvpr", 768): (4 * (2 * 529 + 2 * _linear(529, 529)) + _linear(768, 1024) + _linear(529, 4), 4096),
    ("conv-ap", 768): (_linear(768, 2048), 8192),
    ("cosplace", 768): (1 + _linear(768, 2048), 2048),
    ("boq", 768): (_boq(768, 384, 64, 32), 12288),
    ("boq", 112): (_boq(112, 128, 32, 16), 2048),
    ("vlad", 768): (0, 24576),
    ("salad-route", 112): (_salad(112, 64, 32, 128, 256) + _linear(112, 32), 2176 + 16 * 32),
}


@pytest.mark.parametrize(("name", "width"), BY_HAND)
def test_sizes_are_those_counted_by_hand(name: str, width: int) -> None:
    assert size_of(name, width) == BY_HAND[name, width]


def test_variants_differ_by_what_they_leave_out() -> None:
    whole = size_of("salad", 768)
    assert size_of("salad-no-dustbin", 768) == (whole.trained - 1, 8448)
    scene = _linear(768, 512) + _linear(512, 256)
    assert size_of("salad-no-scene", 768) == (whole.trained - scene, 8192)
    assert size_of("salad-softmax", 768) == size_of("salad-dual-softmax", 768) == whole
    plain = size_of("netvlad", 768)
    assert size_of("netvlad-linear", 768) == (plain.trained + _linear(plain.dim, 8192), 8192)


def test_frozen_weights_count_only_where_asked() -> None:
    model = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4))
    model[0].requires_grad_(False)
    assert parameters(model) == 3 * 4 + 4 + 8  # the norm's statistics are no parameters
    assert parameters(model, trained_only=True) == 8


def test_a_vit_b_has_as_many_as_published() -> None:
    with torch.device("meta"):
        assert parameters(ViT(VITS["vitb14"])) == 86_579_712  # DINOv2's 86,580,480 without its mask token


def test_the_document_shows_the_table_as_it_is() -> None:
    document = Path(__file__).resolve().parents[2] / "docs" / "method.md"
    assert table(768, 112) in document.read_text(encoding="utf-8")
