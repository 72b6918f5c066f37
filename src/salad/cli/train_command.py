"""`salad train`: a model from photos of places, by a preset and whatever is given in place of its settings."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from salad.cli import terminal
from salad.cli.arguments import SHIPPED, File, Folder, Metres, Number, Share, Table, benchmark_of, positive
from salad.errors import BenchmarkError, SaladError, needs_extra

if TYPE_CHECKING:
    from salad.datasets.training_place import TrainingPlace
    from salad.models.describer import Describer
    from salad.training.recipe import Preset
    from salad.training.validation import Judge


Rate = Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")]
Augment = Annotated[
    Literal["lite", "paper", "kornia", "robust", "none"] | None, arg(help_behavior_hint="", metavar="NAME")
]
Sampling = Annotated[Literal["mixed", "one-city", "cliques"] | None, arg(help_behavior_hint="", metavar="NAME")]
PRECISIONS = ("bf16-mixed", "16-mixed", "32-true")
Precision = Annotated[Literal["bf16-mixed", "16-mixed", "32-true"] | None, arg(help_behavior_hint="", metavar="NAME")]


@dataclass(frozen=True)
class TrainCommand:
    """Train a model and write it to TO/model; a run that was interrupted goes on where it stopped.

    What is not given is the preset's. The best weights by the places held out, or by a benchmark of your own, are
    kept in TO/model, the last ones in TO/last.
    """

    data: Annotated[Path | None, arg(metavar="DIR|CSV", help_behavior_hint="")] = None
    """GSV-Cities, a table of `salad places`, a folder of folders (one a place), or a folder of such sets."""
    to: Folder = None
    """The run's folder."""
    preset: str = SHIPPED
    """What to train: paper, small, head, salad-lite, salad-lite-route, salad-vits or salad-vits-whole."""
    start: File = None
    """Other weights to start from: a backbone's file, a name of the zoo, or a model's folder to go on with."""
    resume: bool = False
    """Insist on a run in TO that has not ended."""
    dry_run: bool = False
    """Say what would be trained, for how long and in how much memory; write nothing."""
    steps: Number = None
    """Steps in all, shared between the preset's two stages as it shares them."""
    head_steps: Number = None
    """Steps with the backbone frozen."""
    tune_steps: Number = None
    """Steps with the backbone's last blocks trained too."""
    epochs: Number = None
    """In place of --tune-steps, times through all places; for --sampler one-city."""
    tuned_blocks: Number = None
    """The last blocks of the backbone, trained in the second stage."""
    tuned_share: Share = None
    """How far to go from the first stage's weights to the second's: 1 for all the way."""
    places: Number = None
    """Places in a batch."""
    views: Number = None
    """Photos of each."""
    at_once: Number = None
    """Photos through the model at once: a large batch in the memory of a small one."""
    size: Number = None
    """Side in pixels of the squares trained on."""
    full_steps: Number = None
    """With --size, so many of the last steps at the size in use."""
    head_rate: Rate = None
    """Learning rate of the aggregator."""
    trunk_rate: Rate = None
    """Learning rate of the backbone."""
    weight_decay: Rate = None
    """AdamW's."""
    warmup: Number = None
    """Steps over which a stage's rates rise."""
    last: Share = None
    """Share of the rates left at a stage's end."""
    decay_over: Number = None
    """Steps over which they fall, where not over the whole stage."""
    average: Share = None
    """Decay of the running mean of the weights, which is what is measured and kept; 0 for none."""
    clip: Annotated[float | None, arg(metavar="LENGTH", help_behavior_hint="")] = None
    """Longest gradient of a step."""
    augment: Augment = None
    """How photos are changed: lite, paper, robust or none."""
    mirror: Annotated[bool | None, arg(metavar="True|False", help_behavior_hint="")] = None
    """Whether half of the places are mirrored; a mirrored place is another place."""
    sampler: Sampling = None
    """How batches are drawn: mixed, one-city or cliques."""
    mine_every: Number = None
    """With --sampler cliques, steps between two searches for places that look alike."""
    clique: Number = None
    """With --sampler cliques, places in a clique."""
    cache_versions: Number = None
    """With a frozen backbone, versions of each photo whose tokens are kept on disk."""
    tokens: Folder = None
    """Where they are kept; several runs may share it. In TO by default."""
    held_out: Share = None
    """Share of the places to choose by."""
    measure_every: Number = None
    """Steps between two measurements."""
    save_every: Number = None
    """Steps between two checkpoints."""
    seed: Number = None
    """Of everything random."""
    split_seed: Number = None
    """Of which places are held out, where not --seed: the same for runs to be compared, averaged or gone on with."""
    references: Folder = None
    """Choose by a benchmark: its photos whose places are known."""
    queries: Folder = None
    """Its photos to recognise."""
    truth: Table = None
    """Its CSV query,positives: names within the two folders, positives separated by semicolons."""
    frames: Number = None
    """Right within so many frames, by the last whole number in a photo's name."""
    radius: Metres = None
    """Right within so many metres, by geotag."""
    accelerator: str = "auto"
    """auto, cpu, gpu or mps."""
    devices: int = 1
    """Devices of this machine; each takes a share of every batch."""
    nodes: int = 1
    """Machines; start the same command on each."""
    precision: Precision = None
    """How numbers are held: bf16-mixed, 16-mixed (older graphics cards) or 32-true; the first where it is quick."""
    board: bool = False
    """Draw curves for TensorBoard into TO/board."""

    def run(self) -> int:
        """Train."""
        preset = self._preset()
        positive(self.devices, "devices")
        positive(self.nodes, "nodes")
        judge = self._judge()
        if self.dry_run:
            return self._say_what_would_be(preset)
        data, to = self._required(self.data, "data"), self._required(self.to, "to")
        with needs_extra("training", "train"):
            from salad.training.devices import first_process
            from salad.training.trainer import train

        preset = self._here(preset)
        places = self._places(data)
        # With several devices this very command runs once for each: the first alone draws a bar and speaks.
        with terminal.progress("training") if first_process() else nullcontext() as bar:
            made = train(
                preset,
                places,
                to=to,
                start=self.start,
                accelerator=self.accelerator,
                devices=self.devices,
                nodes=self.nodes,
                judge=judge,
                resume=self.resume,
                board=self.board,
                tokens=self.tokens,
                progress=bar,
                say=terminal.say,
            )
        if first_process():
            self._add_graph(made, [photo for place in places for photo in place.photos])
            terminal.write(str(made))
        return terminal.FOUND

    def _add_graph(self, model: Path, photos: list[Path]) -> None:
        """Let the model run without torch; one that cannot be exported is trained all the same."""
        from salad.models.model_folder import add_graph

        try:
            add_graph(model, photos)
        except SaladError as error:
            terminal.say(f"the model runs by torch alone, for it has no graph: {error}")

    def _say_what_would_be(self, preset: Preset) -> int:
        with needs_extra("trying a training step", "train"):
            from salad.training.dry_run import dry_run

        facts = dry_run(
            self._here(preset),
            None if self.data is None else self._places(self.data),
            start=self.start,
            accelerator=self.accelerator,
            devices=self.devices,
            nodes=self.nodes,
        )
        terminal.write_fields({"preset": self.preset, **facts})
        terminal.say("nothing was written: leave --dry-run out to train")
        return terminal.FOUND

    def _places(self, data: Path) -> list[TrainingPlace]:
        from salad.datasets.places import find_places
        from salad.training.devices import first_process

        return find_places(data, say=terminal.say if first_process() else lambda _: None)

    def _preset(self) -> Preset:
        """The preset with what was given in place of its own settings."""
        from salad.training.recipe import Recipe, preset

        chosen = preset(self.preset)
        recipe = chosen.recipe if self.steps is None else chosen.recipe.of_steps(self.steps)
        # Whatever option has the name of a setting is that setting.
        options = {field.name for field in fields(self)}
        settings = [field.name for field in fields(Recipe) if field.name in options]
        given = {name: getattr(self, name) for name in settings if getattr(self, name) is not None}
        if self.steps is not None and given.keys() & {"head_steps", "tune_steps", "epochs"}:
            raise SaladError("--steps counts both stages: give it, or --head-steps, --tune-steps and --epochs")
        if "tune_steps" in given and "epochs" not in given:
            given["epochs"] = None  # the preset's epochs would stand in place of the steps asked for
        return replace(chosen, recipe=replace(recipe, **given))

    def _here(self, preset: Preset) -> Preset:
        """The preset as the run was begun; of a new one, with a precision that this machine computes in."""
        from salad.training.checkpoint import recipe_of_run
        from salad.training.devices import first_process, precision_here

        run = {} if self.to is None else recipe_of_run(self.to)
        if self.augment is None and (preset.recipe.augment, run.get("augment")) == ("paper", "kornia"):
            if first_process():
                terminal.say(
                    "photos are changed by kornia's RandAugment, as the run was begun; --augment says otherwise"
                )
            preset = replace(preset, recipe=replace(preset.recipe, augment="kornia"))
        wanted = preset.recipe.precision
        begun = run.get("precision")
        chosen = begun if begun in PRECISIONS else precision_here(wanted, self.accelerator)
        if self.precision is not None or chosen == wanted:
            return preset
        if first_process():
            why = "as the run was begun" if begun else f"for this processor has no instructions for {wanted}"
            terminal.say(f"numbers are held in {chosen}, {why}; --precision says otherwise")
        return replace(preset, recipe=replace(preset.recipe, precision=chosen))

    def _judge(self) -> Judge | None:
        """Recall@1 on a benchmark, where one is named."""
        if self.references is None and self.queries is None:
            if (self.truth, self.frames, self.radius) != (None, None, None):
                raise BenchmarkError(
                    "--truth, --frames and --radius say what is right in a benchmark: name its folders with "
                    "--references and --queries"
                )
            return None
        benchmark = benchmark_of(
            self._required(self.references, "references"),
            self._required(self.queries, "queries"),
            truth=self.truth,
            frames=self.frames,
            radius=self.radius,
        )

        def judge(model: Describer) -> dict[str, float]:
            from salad.evaluation.evaluate_benchmark import evaluate

            recall = evaluate(benchmark, model).recall
            return {**{f"R@{k}": percent for k, percent in recall.items()}, "mean": recall[1]}

        return judge

    def _required(self, given: Path | None, name: str) -> Path:
        if given is None:
            raise SaladError(f"--{name} is missing: name the folder (salad train --help says which)")
        return given
