from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import salad
from salad.demo.town import town as drawing
from salad.demo.town.camera import Camera, Shot
from salad.demo.town.canvas import Canvas, noise
from salad.demo.town.facade import front_height, paint_front, paint_side
from salad.demo.town.ground import CELL, Field, Ground, shadows
from salad.demo.town.light import LIGHTS, towards
from salad.demo.town.plan import FRONT, invent, park_cars, plan_town
from salad.demo.town.raster import HOLE, Faces, Texture, cast
from salad.demo.town.scene import Studio
from salad.demo.town.town import Town, draw_town, read_town
from salad.demo.town.visits import CONDITIONS, position_of, take_queries, take_references
from salad.errors import BenchmarkError
from salad.geo import metres_between
from salad.images.photo import read_photo

SMALL = {"references": 4, "queries": 2, "size": (96, 72), "workers": 1}
GREY = Texture.of(np.full((4, 4, 3), 120), np.ones((4, 4), np.uint8), 4.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("town")


@pytest.fixture(scope="module")
def town(folder: Path) -> Town:
    return draw_town(folder, seed=7, **SMALL)


@pytest.fixture(scope="module")
def studio() -> Studio:
    return Studio(plan_town(7, 2))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_only_the_demo_the_tests_and_the_benchmarks_reach_the_town() -> None:
    home = Path(salad.__file__).parent
    outside = [path for path in home.rglob("*.py") if home / "demo" not in path.parents]
    assert outside
    assert not [path for path in outside if "salad.demo.town" in path.read_text(encoding="utf-8")]


# --- geometry


def test_a_camera_looking_east_puts_points_where_the_pinhole_formula_does() -> None:
    camera = Camera((10.0, 20.0, 2.0), 90.0, (400, 300), view=90.0)
    # 5 m ahead, 1 m to the right (south), 1.5 m up; the focal length of 90 degrees is half the width.
    column, row, depth = camera.project(np.array([15.0, 19.0, 3.5]))
    assert (column, row, depth) == pytest.approx((200 + 200 * 1 / 5, 150 - 200 * 1.5 / 5, 5.0))


def test_pitch_lifts_the_view_and_roll_turns_it() -> None:
    ahead = np.array([0.0, 10.0, 0.0])
    assert Camera((0, 0, 0), 0.0, (100, 100), pitch=10.0).project(ahead)[1] > 50
    rolled = Camera((0, 0, 0), 0.0, (100, 100), roll=10.0).project(np.array([0.0, 10.0, 3.0]))
    assert rolled[0] < 50


@given(
    st.floats(0, 360),
    st.floats(-15, 15),
    st.floats(-5, 5),
    st.tuples(*[st.floats(-40, 40)] * 3),
    st.floats(50, 100),
)
@settings(max_examples=60, deadline=None)
def test_a_pixels_ray_leads_back_to_the_point(
    heading: float, pitch: float, roll: float, point: tuple[float, float, float], view: float
) -> None:
    camera = Camera((1.0, -2.0, 1.7), heading, (320, 240), pitch, roll, view)
    column, row, depth = camera.project(np.array(point))
    if depth > 0.5:
        coefficients = camera.linear(np.eye(3))
        ray = coefficients @ [column - 0.5, row - 0.5, 1.0]
        assert np.array(camera.position) + ray * depth == pytest.approx(point, abs=1e-6)


def test_a_box_is_drawn_between_its_projected_corners() -> None:
    camera = Camera((0.0, 0.0, 1.7), 12.0, (320, 240), pitch=5.0, view=70.0)
    faces = Faces()
    faces.add((-1.0, 9.0, 0.0), (4.0, 1.0, 0.0), (0.0, 0.0, 3.0), ("wall",))
    seen = cast(camera, faces, lambda skin: GREY)
    corners = np.array([[-1, 9, 0], [3, 10, 0], [3, 10, 3], [-1, 9, 3]], float)
    expected = camera.project(corners)
    rows, columns = np.nonzero(seen.face == 0)
    assert columns.min() == pytest.approx(expected[:, 0].min(), abs=1.0)
    assert columns.max() + 1 == pytest.approx(expected[:, 0].max(), abs=1.0)
    assert rows.min() == pytest.approx(expected[:, 1].min(), abs=1.0)
    assert rows.max() + 1 == pytest.approx(expected[:, 1].max(), abs=1.0)
    middle = camera.project(corners.mean(axis=0))
    near = seen.nearness[int(middle[1]), int(middle[0])]
    assert 1 / near == pytest.approx(middle[2], rel=0.01)


def test_the_nearer_face_hides_the_farther_and_holes_show_it() -> None:
    camera = Camera((0.0, 0.0, 1.0), 0.0, (64, 64), view=60.0)
    kind = np.ones((4, 4), np.uint8)
    kind[:, :2] = HOLE
    fence = Texture.of(np.full((4, 4, 3), 200), kind, 4.0)
    faces = Faces()
    faces.add((-9.0, 8.0, -9.0), (18.0, 0.0, 0.0), (0.0, 0.0, 18.0), ("wall",))
    faces.add((-9.0, 4.0, -9.0), (18.0, 0.0, 0.0), (0.0, 0.0, 18.0), ("fence",))
    seen = cast(camera, faces, lambda skin: fence if skin == ("fence",) else GREY)
    assert (seen.face[:, :31] == 0).all()
    assert (seen.face[:, 33:] == 1).all()


def test_a_wall_is_not_seen_from_behind_unless_it_has_two_sides() -> None:
    camera = Camera((0.0, 0.0, 1.0), 0.0, (32, 32))
    for both in (False, True):
        faces = Faces()
        faces.add((3.0, 4.0, 0.0), (-6.0, 0.0, 0.0), (0.0, 0.0, 3.0), ("wall",), both=both)
        assert (cast(camera, faces, lambda skin: GREY).face >= 0).any() == both


def test_a_wall_that_runs_past_the_camera_is_cut_at_it() -> None:
    camera = Camera((0.0, 0.0, 1.5), 0.0, (64, 48))
    faces = Faces()
    faces.add((2.0, 30.0, 0.0), (0.0, -60.0, 0.0), (0.0, 0.0, 5.0), ("wall",), both=True)
    seen = cast(camera, faces, lambda skin: GREY)
    assert (seen.face[:24, 60:] == 0).all()
    assert (seen.face[:, :30] == -1).all()


def test_a_shadow_is_as_long_as_the_suns_height_makes_it() -> None:
    high = np.zeros((120, 40, 1), np.float32)
    high[20, 20] = 10.0
    south_at_45 = np.array([0.0, -np.sqrt(0.5), np.sqrt(0.5)])
    shade = shadows(Field(high, 0.0, 0.0), south_at_45).values[..., 0]
    lengths = (np.flatnonzero(shade[:, 20] > 0) - 20) * CELL
    assert lengths.max() == pytest.approx(10.0, abs=2 * CELL)
    # Half way along, the shade reaches half as high.
    assert shade[30, 20] == pytest.approx(5.0, abs=2 * CELL)
    assert (shade[:20] == 0).all()
    assert (shade[:, :19] == 0).all()


def test_a_field_is_read_between_its_cells() -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4, 1)
    field = Field(values, 100.0, 50.0)
    at = field.at(np.array([100.25, 101.0], np.float32), np.array([50.0, 50.25], np.float32))
    assert at[:, 0] == pytest.approx([0.5, 4.0])


# --- the plan


@pytest.mark.parametrize("seed", [1, 7])
def test_houses_stand_clear_of_the_streets_and_of_each_other(seed: int) -> None:
    plan = plan_town(seed, 12)
    share = np.stack(np.meshgrid(np.linspace(0.02, 0.98, 9), np.linspace(0.02, 0.98, 9)), -1).reshape(-1, 2)
    asphalt = np.concatenate([street.line for street in plan.streets])
    points = []
    for house in plan.houses:
        right, back = house.corners[1] - house.corners[0], house.corners[3] - house.corners[0]
        points.append(house.corners[0] + share[:, :1] * right + share[:, 1:] * back)
        assert np.linalg.norm(points[-1][:, None] - asphalt, axis=-1).min() > FRONT - 0.6
    for number, house in enumerate(plan.houses):
        others = np.concatenate(points[:number] + points[number + 1 :])
        right, back = house.corners[1] - house.corners[0], house.corners[3] - house.corners[0]
        across, deep = ((others - house.corners[0]) @ e / (e @ e) for e in (right, back))
        assert not ((across > 0.03) & (across < 0.97) & (deep > 0.03) & (deep < 0.97)).any()


def test_a_larger_town_covers_its_references_densely() -> None:
    plan = plan_town(7, 40)
    drive = take_references(plan, 80, (96, 72))
    places = np.array([shot.camera.position for shot in drive[::2]])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 1e9 * np.eye(len(places))
    assert len(drive) == 80
    assert np.median(gaps.min(axis=1)) < 14


def test_the_plan_is_decided_by_its_seed() -> None:
    first, again, other = plan_town(3, 2), plan_town(3, 2), plan_town(4, 2)
    assert [house.style for house in first.houses] == [house.style for house in again.houses]
    assert [house.style for house in first.houses] != [house.style for house in other.houses]
    assert park_cars(first, 1) == park_cars(again, 1)
    assert park_cars(first, 1) != park_cars(first, 2)


@pytest.mark.parametrize("seed", [0, 7, 19])
def test_every_query_stands_near_a_reference_that_looks_the_same_way(seed: int) -> None:
    plan = plan_town(seed, 12)
    drive = take_references(plan, 24, (96, 72))
    later = take_queries(plan, drive, 24)
    assert {shot.light for shot in later} == set(CONDITIONS)
    for query in later:
        answers = [
            shot
            for shot in drive
            if metres_between(position_of(shot), position_of(query)) <= 10
            and abs((shot.camera.heading - query.camera.heading + 180) % 360 - 180) < 25
        ]
        assert answers


# --- looks


@pytest.mark.parametrize("number", range(24))
def test_every_kind_of_house_can_be_painted(number: int) -> None:
    width = 5.5 + number % 9
    style = invent((5, number), width)
    front, side = paint_front(style, width), paint_side(style, 9.0, 1 + number % 3)
    assert front.kind.shape[0] == pytest.approx(front_height(style, width) * front.grain, abs=1)
    assert np.isfinite(front.rgb).all()
    assert np.isfinite(side.rgb).all()
    assert (front.kind >= 10).any()
    # A wall has many colours: it is painted, not plain.
    assert front.rgb.std() > 8


def test_letters_need_room() -> None:
    canvas = Canvas(2.0, 1.0, (0, 0, 0))
    canvas.write("BAKERY", 0.1, 0.1, 0.2, 0.15, (255, 255, 255))
    assert not canvas.rgb.any()
    canvas.write("BAKERY", 0.1, 0.1, 1.9, 0.6, (255, 255, 255))
    assert canvas.rgb.max() > 200


def test_noise_has_mean_0_and_deviation_1_and_knows_small_shapes() -> None:
    values = noise((64, 96), [1, 2])
    assert (values.mean(), values.std()) == pytest.approx((0, 1), abs=1e-3)
    assert not noise((2, 2), [1]).any()


@pytest.mark.parametrize("light", sorted(LIGHTS))
def test_every_light_gives_a_photo_with_something_on_it(studio: Studio, light: str) -> None:
    street = studio.plan.streets[0]
    point, _ = street.at(street.length / 2)
    shot = Shot("a.jpg", Camera((point[0], point[1], 2.0), 50.0, (96, 72), pitch=5.0), light, 3)
    photo = studio.draw(shot)
    assert photo.shape == (72, 96, 3)
    assert photo.std() > 8
    assert (photo == studio.draw(shot)).all()


def test_night_is_darker_than_day_and_fog_is_paler(studio: Studio) -> None:
    street = studio.plan.streets[1]
    point, _ = street.at(30.0)
    camera = Camera((point[0], point[1], 2.0), 20.0, (96, 72), pitch=5.0)
    photos = {light: studio.draw(Shot("a.jpg", camera, light, 1)).astype(float) for light in ("day", "night", "fog")}
    assert photos["night"].mean() < 0.6 * photos["day"].mean()
    assert photos["fog"].std() < photos["day"].std()


def test_wet_ground_without_a_horizon_and_a_lamp_out_of_sight_do_no_harm(studio: Studio) -> None:
    point, _ = studio.plan.streets[0].at(20.0)
    down = Camera((point[0], point[1], 2.0), 0.0, (48, 36), pitch=-70.0)
    up = Camera((point[0], point[1], 2.0), 0.0, (48, 36), pitch=80.0)
    assert studio.draw(Shot("a", down, "rain", 1)).std() > 0
    assert studio.draw(Shot("a", up, "rain", 1)).std() > 0


def test_the_sun_stands_where_it_is_said_to() -> None:
    east, north, up = towards(LIGHTS["golden evening"])
    azimuth, elevation = LIGHTS["golden evening"].sun
    assert np.degrees(np.arctan2(east, north)) % 360 == pytest.approx(azimuth)
    assert np.degrees(np.arcsin(up)) == pytest.approx(elevation)


def test_the_road_is_asphalt_and_the_pavement_paler(studio: Studio) -> None:
    ground: Ground = studio.ground
    street = studio.plan.streets[0]
    along = np.linspace(20, street.length - 20, 50)
    road, path = (np.array([street.at(a, left)[0] for a in along], np.float32) for left in (0.8, 5.6))
    depth = np.full(50, 5.0, np.float32)
    assert ground.colours(*road.T, depth).mean() + 30 < ground.colours(*path.T, depth).mean()


# --- photos on disk


def test_a_town_has_what_was_asked_for(town: Town, folder: Path) -> None:
    assert (len(town.references), len(town.queries), len(town.truth)) == (4, 2, 2)
    for path in town.references + town.queries:
        with Image.open(path) as photo:
            assert photo.size == (96, 72)
    assert len(town.streets) == 4
    assert all(len(block) == 4 for block in town.blocks)
    assert read_town(folder) == town
    assert set(town.conditions.values()) <= set(CONDITIONS)


def test_positions_are_those_the_photos_were_drawn_from(town: Town, folder: Path) -> None:
    plan = plan_town(7, 2)
    drive = take_references(plan, 4, (96, 72))
    for path, shot in zip(town.references, drive, strict=True):
        photo = read_photo(path)
        assert photo.where is not None
        assert metres_between(photo.where, position_of(shot)) < 0.1
        assert photo.heading == pytest.approx(shot.camera.heading, abs=0.02)
        assert photo.time is not None
    with (folder / "truth.csv").open(newline="") as file:
        rows = {row["query"]: row for row in csv.DictReader(file)}
    for path, shot in zip(town.queries, take_queries(plan, drive, 2), strict=True):
        photo, row = read_photo(path), rows[path.name]
        assert photo.where is None
        assert photo.heading == pytest.approx(float(row["heading"]), abs=0.02)
        assert photo.time is not None
        assert row["condition"] == shot.light
        assert metres_between(town.truth[path.name], position_of(shot)) < 0.1
        assert float(row["lat"]) == pytest.approx(town.truth[path.name].lat, abs=1e-7)


def test_the_seed_decides_every_byte_and_the_workers_none(
    town: Town, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing, "RUN", 3)
    told: list[tuple[int, int]] = []
    draw_town(tmp_path / "a", seed=7, **(SMALL | {"workers": 2}), progress=lambda *at: told.append(at))
    assert contents(tmp_path / "a") == contents(folder)
    assert told == [(3, 6), (6, 6)]
    other = draw_town(tmp_path / "b", seed=8, **SMALL)
    assert other.references[0].read_bytes() != town.references[0].read_bytes()


def test_without_leave_to_start_processes_the_town_is_drawn_all_the_same(
    town: Town, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError("no processes here")

    monkeypatch.setattr(drawing, "RUN", 3)
    monkeypatch.setattr(drawing, "ProcessPoolExecutor", refuse)
    draw_town(tmp_path, seed=7, **(SMALL | {"workers": 2}))
    assert contents(tmp_path) == contents(folder)


def test_a_finished_town_is_left_alone_and_a_broken_one_is_drawn_again(
    town: Town, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    with monkeypatch.context() as patch:
        patch.setattr("salad.demo.town.town.draw_all", lambda *_, **__: pytest.fail("drawn again"))
        assert draw_town(folder, seed=7, **SMALL) == town
    town.references[1].unlink()
    with pytest.raises(BenchmarkError, match=r"lacks ref_0002\.jpg"):
        read_town(folder)
    (folder / "references" / "stray.jpg").write_bytes(b"")
    done: list[int] = []
    draw_town(folder, seed=7, **SMALL, progress=lambda at, _: done.append(at))
    assert contents(folder) == before
    assert done == [1, 2, 3, 4, 5, 6]


def test_a_stop_half_way_leaves_no_town(town: Town, folder: Path, tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_town(tmp_path, seed=7, **SMALL, progress=stop)
    with pytest.raises(BenchmarkError, match="holds no finished town"):
        read_town(tmp_path)
    draw_town(tmp_path, seed=7, **SMALL)
    assert contents(tmp_path) == contents(folder)


@pytest.mark.parametrize("wrong", [{"references": 0}, {"queries": -1}, {"size": (8, 72)}, {"seed": -1}])
def test_numbers_out_of_range_are_refused(tmp_path: Path, wrong: dict[str, int]) -> None:
    with pytest.raises(BenchmarkError, match="cannot be drawn: ask for"):
        draw_town(tmp_path, **({"seed": 7} | SMALL | wrong))
    assert not list(tmp_path.iterdir())


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "holiday.jpg").write_bytes(b"mine")
    with pytest.raises(BenchmarkError, match=r"holiday\.jpg"):
        draw_town(tmp_path, **SMALL)
    assert contents(tmp_path) == {"holiday.jpg": b"mine"}
    with pytest.raises(BenchmarkError, match="choose another folder"):
        draw_town(tmp_path / "holiday.jpg", **SMALL)


def test_another_version_of_a_town_is_told(tmp_path: Path) -> None:
    (tmp_path / "town.json").write_text(json.dumps({"version": 0}))
    with pytest.raises(BenchmarkError, match="draw the town again"):
        read_town(tmp_path)
