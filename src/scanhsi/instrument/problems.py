"""What pydantic found wrong, as sentences for the person who wrote it: key, value found, what is allowed."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

_LONGEST_VALUE: Final = 60
_NESTED: Final = "nested"


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """One sentence a problem: ``storage.codec = "gzip": input should be 'lz4' or 'zstd'``.

    Args:
        error: What validation raised.
        model: The model that was validated, to suggest known keys.
    """
    return list(_sentences(error.errors(include_url=False), model, ()))


def nested_problems(errors: Sequence[Any], model: type[BaseModel] | None = None) -> PydanticCustomError:
    """An error to raise from a validator that stands for several, which `problems_of` lists one by one.

    Args:
        errors: As `ValidationError.errors` gives them (loc, msg, input, type).
        model: Model that they are about.
    """
    text = "; ".join(f"{_dotted(item['loc'])}: {item['msg']}" for item in errors)
    return PydanticCustomError(_NESTED, "{text}", {"text": text, "errors": list(errors), "model": model})


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that was probably meant."""
    return next(iter(difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)), None)


def show(value: object) -> str:
    """A value as a TOML file would write it, shortened."""
    plain = isinstance(value, str | int | float | list | dict | None)
    text = json.dumps(value, ensure_ascii=False, default=repr) if plain else repr(value)
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def _sentences(
    errors: Iterable[Any],
    model: type[BaseModel] | None,
    prefix: tuple[str | int, ...],
) -> Iterator[str]:
    for item in errors:
        loc = prefix + tuple(item["loc"])
        if item["type"] == _NESTED:
            yield from _sentences(item["ctx"]["errors"], item["ctx"]["model"], loc)
        else:
            yield _sentence(item, _model_at(model, item["loc"][:-1]), loc)


def _sentence(item: Mapping[str, Any], model: type[BaseModel] | None, loc: tuple[str | int, ...]) -> str:
    key = _dotted(loc)
    if item["type"] == "missing":
        return f"{key} is missing{_expected(model, str(loc[-1]))}"
    if item["type"] == "extra_forbidden":
        return f"{key} = {show(item['input'])}: there is no such key{_known(model, str(loc[-1]))}"
    message = str(item["msg"]).removeprefix("Value error, ")
    return f"{key} = {show(item['input'])}: {message[:1].lower()}{message[1:]}"


def _known(model: type[BaseModel] | None, word: str) -> str:
    if model is None:
        return ""
    keys = [field.alias or name for name, field in model.model_fields.items()]
    guess = nearest(word, keys)
    if guess:
        return f"; did you mean {guess}?"
    return f"; known are {', '.join(keys)}" if keys else "; this takes no keys"


def _expected(model: type[BaseModel] | None, word: str) -> str:
    """What the model says of a field that was not given."""
    if model is None:
        return ""
    for name, field in model.model_fields.items():
        if word in (name, field.alias) and field.description:
            return f" ({field.description.rstrip('.')})"
    return ""


def _model_at(model: type[BaseModel] | None, loc: Sequence[str | int]) -> type[BaseModel] | None:
    """The model of the table that a location leads to, where it is one."""
    for part in loc:
        if model is None:
            return None
        fields = {field.alias or name: field for name, field in model.model_fields.items()} | model.model_fields
        field = fields.get(str(part))
        model = _first_model(field.annotation) if field else None
    return model


def _first_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_first_model(argument) for argument in get_args(annotation))
    return next((model for model in found if model), None)


def _dotted(loc: Sequence[str | int]) -> str:
    return ".".join(str(part) for part in loc) or "(the whole)"
