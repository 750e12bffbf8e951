"""Settings from TOML files: strict models, errors that name the file, the key and the nearest known key.

Here: the base of all settings models, the kinds of numbers in them, and the reading. Not here: any particular setting:
each is declared in the module that uses it.
"""

import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gs2ci.core.errors import InputError, reason_of

M = TypeVar("M", bound=BaseModel)

SIMULATED: Final = "simulated"
"""The `port` of a device that is simulated by its twin."""
DAY_S: Final = 86_400.0
"""Limits far beyond every bench: a larger value is a wrong unit, and would exceed clocks or memory."""
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, lt=1)]
Duration = Annotated[float, Field(gt=0, le=DAY_S)]
Delay = Annotated[float, Field(ge=0, le=DAY_S)]
Offset = Annotated[float, Field(ge=-DAY_S, le=DAY_S)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]

_PLAIN_WORDS: Final = {
    "Input should be": "it should be",
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "text in quotes",
    "a valid boolean": "true or false",
    "a valid dictionary": "a table",
    "a valid list": "a list",
    "a valid tuple": "a list",
}
MOST_TOLD: Final = 8
"""Largest number of problems reported for one file; with more, it is probably another kind of file."""


class ConfigTable(BaseModel):
    """Base of settings: unknown keys are errors, numbers are finite, values are not changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)

    @model_validator(mode="before")
    @classmethod
    def _no_truth_is_a_number(cls, data: Any) -> Any:
        """Return a table as it is, if no number in it is true or false, which pydantic takes for 1 and 0.

        Raises:
            ValueError: One is.
        """
        for name, field in cls.model_fields.items() if isinstance(data, dict) else ():
            if isinstance(data.get(name), bool) and _is_number(field.annotation):
                raise ValueError(f"{name!r} is {str(data[name]).lower()}: it should be a number")
        return data


def read_settings(path: Path, model: type[M]) -> M:
    """Read a TOML file into a model.

    Args:
        path: The file.
        model: The model that it has to fit.

    Raises:
        InputError: The file cannot be read, is not TOML, or does not fit; names each key that is wrong and, where
            it is unknown, the nearest known one.
    """
    return settings_from(read_toml(path)[0], model, path)


def settings_from(data: Mapping[str, Any], model: type[M], path: Path) -> M:
    """Turn the tables of a TOML file into a model.

    Args:
        data: The tables.
        model: The model that they have to fit.
        path: Their file, for errors.

    Raises:
        InputError: They do not fit, as `read_settings` says.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors()
        sentences = [_sentence(model, dict(problem)) for problem in problems[:MOST_TOLD]]
        if len(problems) > MOST_TOLD:
            sentences.append(f"and {len(problems) - MOST_TOLD} more like these")
        told = f" {sentences[0]}" if len(sentences) == 1 else "".join(f"\n  {sentence}" for sentence in sentences)
        raise InputError(f"{path}:{told}") from error


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Read a TOML file; return its tables and its text.

    Raises:
        InputError: The file cannot be read or is not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")  # Windows' editors put a byte order mark in front
        tables = tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({reason_of(error)})", remedy="check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not text in UTF-8 ({error.reason})", remedy="give a TOML file") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not TOML: {error}", remedy="mend the line named") from error
    except RecursionError as error:
        raise InputError(f"{path} is not TOML of ours: it nests too deep", remedy="give a rig file") from error
    _refuse_nul(path, tables, "")
    return tables, text


def _refuse_nul(path: Path, value: Any, key: str) -> None:
    """Refuse values with NUL characters: names, paths and ports have none, and system and HDF5 do not accept them."""
    if isinstance(value, str) and "\0" in value:
        raise InputError(f"{path}: {key!r} has a NUL character (\\u0000) in it", remedy="take it out")
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, part in inside:
        _refuse_nul(path, name, f"{key} key")
        _refuse_nul(path, part, str(name) if not key else f"{key}.{name}")


def _sentence(model: type[BaseModel], problem: dict[str, Any]) -> str:
    where = problem["loc"]
    table, models = _table(model, where[:-1])
    known = sorted({name for one in models for name in one.model_fields})
    key = str(where[-1]) if where else ""
    place = f"[{table}]" if table else "the top of the file"
    if problem["type"] == "extra_forbidden":
        near = get_close_matches(key, known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
        return f"unknown key {key!r} in {place}{hint}"
    if problem["type"] == "missing":
        return f"key {key!r} is missing in {place}"
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        kinds = [str(_tag(one)) for one in _table(model, where)[1]]
        given = problem.get("ctx", {}).get("tag")
        asked = "key 'kind' is missing" if given is None else f"unknown kind {str(given)[:80]!r}"
        near = get_close_matches(str(given), kinds, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return f"{asked} in [{_dotted(where)}]; allowed: {', '.join(map(repr, kinds))}{hint}"
    told = _in_plain_words(problem["msg"])
    whole, models = _table(model, where)
    if problem["type"] == "value_error" and (models or not where):  # of keys that do not go together
        return f"[{whole}]: {told}" if whole else told
    shown = repr(problem.get("input"))[:80]
    return f"{key!r} in {place} is {shown}: {told}"


def _in_plain_words(message: str) -> str:
    """Express pydantic's message in the terms of a settings file."""
    said = message.removeprefix("Value error, ").split(", unable to", maxsplit=1)[0]
    for theirs, ours in _PLAIN_WORDS.items():
        said = said.replace(theirs, ours)
    return said


def _dotted(where: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in where)


def _table(model: type[BaseModel], where: tuple[int | str, ...]) -> tuple[str, list[type[BaseModel]]]:
    """Follow a location into the model; return the table's name without union tags, and the keys allowed there."""
    names: list[str] = []
    here: Any = model
    for part in where:
        models = _models(here)
        tagged = [one for one in models if _tag(one) == part]
        if tagged:
            here = tagged[0]
            continue
        names.append(str(part))
        owner = next((one for one in models if part in one.model_fields), None)
        here = owner.model_fields[str(part)].annotation if owner else None
    return ".".join(names), _models(here)


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation names, through unions and Annotated."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Union, UnionType, Annotated):
        return [model for part in get_args(annotation) for model in _models(part)]
    return []


def _is_number(annotation: Any) -> bool:
    """Tell whether a key takes numbers, and neither true nor false."""
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    kinds = [get_args(part)[0] if get_origin(part) is Annotated else part for part in parts]
    return (int in kinds or float in kinds) and bool not in kinds


def _tag(model: type[BaseModel]) -> str | None:
    kind = model.model_fields.get("kind")
    if kind is None or get_origin(kind.annotation) is not Literal:
        return None
    return str(get_args(kind.annotation)[0])
