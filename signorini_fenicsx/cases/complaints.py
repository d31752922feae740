"""Errors that pydantic finds in a file, in one sentence with key and reason."""

import contextlib
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean

WORDS = {
    **dict.fromkeys(("E", "E_modulus", "youngs_modulus"), "young"),
    **dict.fromkeys(("nu", "poissons_ratio"), "poisson viscosity"),
    **dict.fromkeys(("mu", "eta"), "viscosity mu"),
    **dict.fromkeys(("k", "conductivity", "permeability", "diffusivity", "D", "lambda"), "kappa K"),
    **dict.fromkeys(("Ks", "K_s", "k_s", "Ksat"), "K"),
    **dict.fromkeys(("porosity", "thetas"), "theta_s"),
    **dict.fromkeys(("source", "body_force", "load", "gravity"), "f"),
    **dict.fromkeys(("traction", "tractions", "flux", "heat_flux", "neumann"), "g_N"),
    **dict.fromkeys(("dirichlet", "displacement", "temperature", "velocity"), "u_D"),
    **dict.fromkeys(("u0", "u_0", "initial_condition"), "initial"),
    **dict.fromkeys(("dt", "time_step", "n_steps"), "steps"),
    **dict.fromkeys(("t_end", "T", "end_time", "final_time"), "end"),
    **dict.fromkeys(("symmetry", "roller", "rollers"), "fixed"),
    **{"signorini": "contact", "contact": "signorini", "fixed": "dirichlet", "friction": "law"},
    **dict.fromkeys(("mesh_size", "element_size"), "h"),
}
"""What others call a key, with the keys that may be meant."""
VALUES = {"neumann": "g_N", "dirichlet": "u_D", "signorini": "psi", "contact": "gap"}
"""The data of the parts in a list of `[boundary]`."""
FIXED = 'such as {left = "x"}, with the components, letters of xyz, or "n" or "t"'


def complaint(error: ValidationError, root: type[BaseModel], section: str = "", of: str = "") -> str:
    """The first error that pydantic finds in a file, as one sentence with the place in TOML's notation.

    Args:
        error: What pydantic found.
        root: The model of the file, or of a section of it.
        section: Name of this section.
        of: Of what the keys are, in words, in the place of the section.
    """
    errors = error.errors(include_url=False)
    first = next((each for each in errors if each["type"] == "extra_forbidden"), errors[0])  # a key that is misspelt
    above = [section] if section else []
    *sections, last = above + [str(step) for step in first["loc"]] or [""]
    place = "".join(f"[{section}] " for section in sections[:1]) + ".".join([*sections[1:], last])
    if any(isinstance(step, int) for step in first["loc"]):  # of a list of sections, such as [[law]]
        place = ".".join([*sections, last])
    owner = f" {of}" if of else f" in [{sections[0]}]" if sections else ""
    match first["type"]:
        case "extra_forbidden":
            keys = _known_keys(root, sections[len(above) :], last)
            return f"unknown key '{last}'{owner}; known are {keys}{'' if 'did you' in keys else _elsewhere(root, last)}"
        case "missing":
            return f"missing {'key' if owner else 'section or key'} '{last}'{owner}"
        case "model_type" | "model_attributes_type":
            name, header = (place, f"[[{sections[-1]}]]") if last.isdigit() else (f"'{last}'", f"[{last}]")
            return f"{name} must be a section, {header}, not {shown(first['input'])}"
        case "value_error":
            message = str(first["ctx"]["error"])
            where = f"{place}:" if owner else f"[{last}]"
            return f"{where} {message}" if last else message
        case "dict_type":
            table = FIXED if place == "[boundary] fixed" else "{name = value}"
            return f"{place}: must be a table, {table}, not {shown(first['input'])}"
        case "list_type":
            what, hint = _list_of(root, sections, last)
            return f"{place}: must be {what}, not {shown(first['input'])}{hint}"
        case "int_from_float":
            return f"{place}: must be a whole number, not {shown(first['input'])}"
        case "string_type":
            return f"{place}: must be a text, not {shown(first['input'])}"
        case "too_short":
            return f"{place}: must not be empty"
    message = (first["msg"][0].lower() + first["msg"][1:]).replace("input should be", "must be")
    return f"{place}: {message}, not {shown(first['input'])}"


def _list_of(root: type[BaseModel], sections: list[str], last: str) -> tuple[str, str]:
    """What a list is of, in words: sections, parts of the boundary, or values; and what else there is to say."""
    if not sections and _section(root, last) is not BaseModel:
        return f"a section with two brackets, [[{last}]], of which there may be several", ""
    if sections != ["boundary"]:
        return "a list, in square brackets", ""
    values = f"; their values are in [problem] {VALUES[last]}" if last in VALUES else ""
    return 'a list of parts such as ["left", "top"]', f"{values}; without a list dirichlet all other parts are in that"


def _elsewhere(root: type[BaseModel], wrong: str) -> str:
    """The section that has a key, or what else it is called there; empty if none has."""
    for key in (wrong, *WORDS.get(wrong, "").split()):
        for name in root.model_fields:
            if key in keys_of(_section(root, name)):
                several = get_origin(root.model_fields[name].annotation) is list
                return f"; '{key}' is a key of {f'[[{name}]]' if several else f'[{name}]'}"
    return ""


def shown(value: object) -> str:
    """A value as Python writes it, but for true and false, in at most 60 characters."""
    try:
        text = str(value).lower() if isinstance(value, bool) else repr(value)
    except (ValueError, RecursionError):  # integers of many digits, deep lists
        text = f"this {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


@contextlib.contextmanager
def told(where: str = "") -> Iterator[None]:
    """Tell pydantic what is refused: for an InputError there is a ValueError with the same words behind this place."""
    try:
        yield
    except InputError as error:
        raise ValueError(f"{where}{error}") from None


@contextlib.contextmanager
def naming(case: str) -> Iterator[None]:
    """Name the case in messages about its keys that only what solves it can find."""
    try:
        yield
    except InputError as error:
        words = str(error)
        if words.startswith(("[", "h = ", "element: ")):
            error.args = (f"case {case}: {'' if words[0] == '[' else '[solve] '}{words}",)
        raise


def _known_keys(model: type[BaseModel], sections: list[str], wrong: str) -> str:
    for section in sections:
        if section in model.model_fields:  # else which one of a list or table of sections it is
            model = _section(model, section)
    keys = keys_of(model)
    meant = WORDS.get(wrong, wrong).split()
    return ", ".join(keys) + next((hint for each in meant if (hint := did_you_mean(each, keys))), "")


def _section(model: type[BaseModel], name: str) -> type[BaseModel]:
    """The model of a section of a file; one without keys for what is none."""
    kinds: list[Any] = [model.model_fields[name].annotation]
    for kind in kinds:  # a union with None of a section that may be left out; a table with a section for each name
        kinds += get_args(kind)
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), BaseModel)


def keys_of(model: type[BaseModel]) -> list[str]:
    """The keys of a section that a file may contain."""
    return [key for key, field in model.model_fields.items() if not field.exclude]
