"""`salad weights`: which models there are, and getting them onto this machine."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg, subcommand

from salad.cli import terminal
from salad.cli.arguments import Format, ModelName, Number, model_name_for, positive
from salad.errors import WeightsError, needs_extra

Name = Annotated[Positional[str], arg(metavar="NAME", help="A name of the zoo.")]
CheckPhotos = Annotated[
    Path | None,
    arg(metavar="DIR", help_behavior_hint="", help="Photos to check the graph on; made pictures where not given."),
]


@dataclass(frozen=True)
class ListModels:
    """List the models of the zoo."""

    format: Format = "table"

    def run(self) -> int:
        """List."""
        from salad.models import hub

        rows = [(entry, hub.path_of(entry.name).exists()) for entry in hub.ZOO.values()]
        if self.format == "json":
            terminal.write_json(
                [{"name": e.name, "here": here, "licence": e.licence, "note": e.note} for e, here in rows]
            )
            return terminal.FOUND
        from rich.table import Table

        table = Table("name", "here", "licence", "note", box=None, pad_edge=False, header_style="bold")
        for entry, here in rows:  # without addresses, which `weights info` tells: the table is wide enough
            table.add_row(entry.name, "yes" if here else "no", entry.licence, entry.note)
        terminal.write_table(table)
        return terminal.FOUND


@dataclass(frozen=True)
class ModelInfo:
    """Say everything the zoo knows of a model."""

    name: Name

    def run(self) -> int:
        """Tell."""
        from salad.models import hub

        entry, path = hub.entry(self.name), hub.path_of(self.name)
        known = {key: value for key, value in asdict(entry).items() if value is not None}
        terminal.write_fields(known | {"path": path, "here": "yes" if path.exists() else "no"})
        return terminal.FOUND


@dataclass(frozen=True)
class FetchModel:
    """Fetch a model's weights; goes on where an interrupted download stopped."""

    name: Name

    def run(self) -> int:
        """Fetch."""
        from salad.models import hub

        # Before the download, not after it: some licences forbid what people are about to do.
        terminal.say(f"{self.name}: {hub.entry(self.name).licence}")
        with terminal.progress(f"fetching {self.name}") as bar:
            path = hub.fetch(self.name, progress=bar)
        terminal.write(str(path))
        return terminal.FOUND


@dataclass(frozen=True)
class ConvertFile:
    """Turn a published file into a folder of our own format."""

    file: Annotated[Positional[Path], arg(metavar="FILE", help="The published file.")]
    to: Path
    """The folder to make."""
    heads: Number = None
    """Attention heads, where not width / 64: no file says them."""
    photos: CheckPhotos = None

    def run(self) -> int:
        """Convert."""
        from salad.models.model_folder import load, write_folder

        folder = write_folder(load(self.file, heads=self.heads), self.to)
        _with_graph(folder, self.photos)
        terminal.write(str(folder))
        return terminal.FOUND


@dataclass(frozen=True)
class MakeVocabulary:
    """Make AnyLoc's model for a domain: VLAD over a backbone, its vocabulary from an index's photos, no training."""

    index: Annotated[Path, arg(metavar="INDEX")]
    """The index whose photos to take; many are not needed, for some are drawn."""
    to: Path
    """The folder to make."""
    model: ModelName = None
    """Whose backbone to take: a name of the zoo, a folder or a published file; by default the index's own model."""
    clusters: int = 32
    """Words of the vocabulary; a descriptor has as many times the width of a token."""
    seed: int = 0
    """Of the photos and tokens drawn, and of k-means."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""

    def run(self) -> int:
        """Make the vocabulary."""
        from salad.index.index import Index
        from salad.models.model_folder import add_graph, load, write_folder

        with needs_extra("making a vocabulary", "train"):
            from salad.training.vocabulary import with_vocabulary

        positive(self.clusters, "--clusters")
        if self.to.exists():  # said before the work, not after it
            raise WeightsError(f"{self.to} exists already; choose another folder, or remove it first")
        # Closed again before the model works for minutes: others may add to the index meanwhile.
        with Index.open(self.index) as index:
            photos = list(index.held_photos())
        model, unreadable = load(self.model or model_name_for(self.index), device=self.device), list[str]()
        with terminal.progress("gathering tokens") as bar:
            made = with_vocabulary(
                model,
                photos,
                seed=self.seed,
                clusters=self.clusters,
                passed_over=lambda error: unreadable.append(str(error)),
                progress=bar,
            )
        for sentence in terminal.first_few(unreadable, what="could not be read"):
            terminal.say(sentence)
        folder = write_folder(made, self.to)
        add_graph(folder, photos)
        terminal.write(str(folder))
        return terminal.FOUND


@dataclass(frozen=True)
class MeanOfModels:
    """Average the weights of models that were trained from one start, as another model."""

    models: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="MODEL", help="Two or more built alike: folders, or names of the zoo."),
    ]
    to: Path
    """The folder to make."""
    photos: CheckPhotos = None

    def run(self) -> int:
        """Average."""
        from salad.models.model_folder import load, write_folder

        with needs_extra("averaging weights", "torch"):
            from salad.network.checkpoints import mean

        folder = write_folder(mean([load(each).network for each in self.models]), self.to)
        _with_graph(folder, self.photos)
        terminal.write(str(folder))
        return terminal.FOUND


@dataclass(frozen=True)
class WriteGraph:
    """Put a graph into a model's folder, so that it runs without torch; it is checked against torch first."""

    model: Annotated[Positional[Path], arg(metavar="DIR", help="A model's folder.")]
    photos: CheckPhotos = None

    def run(self) -> int:
        """Export."""
        terminal.write(str(_with_graph(self.model, self.photos)))
        return terminal.FOUND


def _with_graph(folder: Path, photos: Path | None) -> Path:
    """Export a model, checked on photos of a folder where one is named."""
    from salad.images.finding import find_photos
    from salad.models.model_folder import add_graph

    return add_graph(folder, [] if photos is None else find_photos([photos], on_unreadable=terminal.say))


@dataclass(frozen=True)
class WeightsCommand:
    """See which models there are, and get them onto this machine."""

    command: (
        Annotated[ListModels, subcommand("list")]
        | Annotated[ModelInfo, subcommand("info")]
        | Annotated[FetchModel, subcommand("fetch")]
        | Annotated[ConvertFile, subcommand("convert")]
        | Annotated[MakeVocabulary, subcommand("vocabulary")]
        | Annotated[MeanOfModels, subcommand("mean")]
        | Annotated[WriteGraph, subcommand("graph")]
    )

    def run(self) -> int:
        """Pass on."""
        return self.command.run()
