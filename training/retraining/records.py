"""What a retraining leaves in the records: figures, bundle, trees, pictures, cards, environment, and a model to ask."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from roadgrip.bundle import BundleManifest
from training.bundle_card import card_of
from training.bundle_making import AS_UNSEEN, MadeBundle
from training.data.data_shelf import DataSet, to_json
from training.marked_tables import percent, table
from training.retraining.environment import code_version, environment, model_requirements, requirements
from training.retraining.model_graph import ERROR_OUTPUT_NAME, MU_OUTPUT_NAME, joined_graph
from training.retraining.pictures import write_pictures
from training.retraining.registry import BUNDLE_FOLDER_NAME, BUNDLE_WORD, TREES_FOLDER_NAME
from training.retraining.tree_files import write_trees
from training.table_figures import OWN_ROADS
from training.tracking import MODEL_FOLDER_NAME, TrackedRun, write_onnx_model

PLOTS_FOLDER_NAME = "plots"
_EXAMPLE_ROWS_COUNT = 5


def record_bundle(
    run: TrackedRun, made: MadeBundle, data_sets: Sequence[DataSet], folder: Path, *, tools: Mapping[str, str]
) -> None:
    """Keep all that is known of a bundle with the run that made it.

    Args:
        run: The run.
        made: The bundle.
        data_sets: What it learned from.
        folder: Holds the bundle in `BUNDLE_FOLDER_NAME`; everything else is written beside it.
        tools: Versions of the tools that models are made with.
    """
    code = code_version()
    run.metrics(made.manifest.metrics)
    run.word(BUNDLE_WORD, made.manifest.bundle_id)
    run.word("mlflow.note.content", summary(made))
    if "code.git_commit" in code:
        run.word("mlflow.source.git.commit", code["code.git_commit"])
    for data_set in data_sets:
        card = data_set.card
        profile = json.dumps({"kind": card.kind, "rows_count": card.rows_count, "usable_count": card.usable_count})
        run.data_set(card.name, digest=card.digest, source=card.origin, profile=profile)
    write_trees(made, folder / TREES_FOLDER_NAME)
    write_pictures(made, folder / PLOTS_FOLDER_NAME)
    _write_model(made.manifest, folder / BUNDLE_FOLDER_NAME, folder / MODEL_FOLDER_NAME)
    _write_texts(made, data_sets, folder, tools=tools)
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            run.folder(path, path.name)
        else:
            run.file(path)


def short_figures(made: MadeBundle) -> list[tuple[str, list[float | None]]]:
    """Return the mean errors that matter most, a line each, for each model of the bundle in its order.

    A figure that a model does not have is None.
    """
    lines = {
        "known roads": "known_roads",
        "roads never seen": "unseen_roads",
        "- at least 60 % of the grip used": "unseen_roads.high_use",
        "own roads, by other drives there": OWN_ROADS,
        "own roads, as if never seen": AS_UNSEEN,
        **{f"{local.section_id}, by its own model": f"local.{local.section_id}" for local in made.local},
    }
    metrics, versions = made.manifest.metrics, [model.plan.version for model in made.models]
    found = [
        (title, [metrics.get(f"mape_ratio.{part}.{version}") for version in versions]) for title, part in lines.items()
    ]
    return [(title, errors) for title, errors in found if any(error is not None for error in errors)]


def summary(made: MadeBundle) -> str:
    """Return a bundle in a few lines of Markdown."""
    head = ("mean error", *(f"feature table {model.plan.table.version}" for model in made.models))
    rows = [
        [title, *("-" if error is None else percent(error) for error in errors)]
        for title, errors in short_figures(made)
    ]
    learned = made.manifest.provenance["learned_from"]
    return f"Bundle `{made.manifest.bundle_id}`, learned from {learned}.\n\n{table(head, rows)}"


def data_digests(data_sets: Sequence[DataSet]) -> dict[str, str]:
    """Return the digests of data sets by what they are called, for records and provenance."""
    return {f"data.{data_set.card.name}": data_set.card.digest for data_set in data_sets}


def _write_texts(made: MadeBundle, data_sets: Sequence[DataSet], folder: Path, *, tools: Mapping[str, str]) -> None:
    texts = {
        "card.md": f"# {made.manifest.name}\n\n{card_of(made.manifest)}",
        "environment/environment.json": json.dumps(environment(tools), indent=1, sort_keys=True) + "\n",
        "environment/requirements.txt": "\n".join(requirements()) + "\n",
        **{f"data/{data_set.card.name}.json": to_json(data_set.card) for data_set in data_sets},
    }
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


def _write_model(manifest: BundleManifest, bundle: Path, folder: Path) -> None:
    """Write the models of the newest feature table as one that mlflow can load and serve."""
    first = manifest.models[0]
    friction, *error = ((bundle / name).read_bytes() for name in first.files)
    write_onnx_model(
        joined_graph(friction, error[0] if error else None),
        folder,
        feature_names=first.feature_names,
        answer_names=[MU_OUTPUT_NAME, *([ERROR_OUTPUT_NAME] if error else [])],
        example_rows=np.array(first.golden.rows[:_EXAMPLE_ROWS_COUNT]),
        requirements=model_requirements(),
        words={BUNDLE_WORD: manifest.bundle_id, "table_digest": first.table_digest},
    )
