"""Recipes: named plans, each a JSON file in the data folder."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from scanhsi.service.folder import Folder
from scanhsi.service.models import Recipe, RecipeEntry
from scanhsi.service.refusals import NoSuch

ENDING: Final = ".recipe.json"


def recipes(folder: Folder) -> list[RecipeEntry]:
    """All of them, by name; files that are none are left out."""
    found: list[RecipeEntry] = []
    for path in sorted(folder.files(ENDING)):
        recipe = _read(path)
        if recipe is not None:
            found.append(_entry(path.name.removesuffix(ENDING), recipe))
    return found


def read_recipe(folder: Folder, name: str) -> RecipeEntry:
    """One of them.

    Raises:
        NoSuch: There is none of that name.
    """
    recipe = _read(folder.file(name, ENDING))
    if recipe is None:
        raise NoSuch(f"there is no recipe {name}.", hint="GET /api/v1/recipes")
    return _entry(name, recipe)


def write_recipe(folder: Folder, name: str, recipe: Recipe) -> RecipeEntry:
    """Keep one; replaces an older one of that name."""
    path = folder.file(name, ENDING)
    new = path.with_name(f".{path.name}.new")
    new.write_text(json.dumps(recipe.model_dump(mode="json", exclude_unset=True), indent=2) + "\n")
    os.replace(new, path)
    return _entry(name, recipe)


def remove_recipe(folder: Folder, name: str) -> None:
    """Remove one.

    Raises:
        NoSuch: There is none of that name.
    """
    try:
        folder.file(name, ENDING).unlink()
    except FileNotFoundError:
        raise NoSuch(f"there is no recipe {name}.", hint="GET /api/v1/recipes") from None


def _entry(name: str, recipe: Recipe) -> RecipeEntry:
    return RecipeEntry(name=name, **recipe.model_dump(exclude_unset=True))


def _read(path: Path) -> Recipe | None:
    try:
        written: Any = json.loads(path.read_text())
        return Recipe.model_validate(written)
    except (OSError, ValueError, ValidationError):
        return None
