# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of expression keys: recognise the convention that they follow, and rename them to another.

`key_table.py` lists the names. Key names are compared by their words, so case, separators, `_L` for `Left` and prefixes
that programs add (`blendShape1.`, `Head_`) make no difference.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np

from zoomout_core.messages import Message, enumeration, message, plural, warning
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.keys.key_table import CONVENTIONS, Cell, Sum, read_table
from zoomout_core.transfer.keys.key_words import common_words, forms_of, forms_without

# Names follow a convention if at least this many of them belong to it, and if half of them do, or half of its names are
# present. Fewer may be a coincidence, such as VRM's "a".
MIN_NAMES, MIN_SHARE = 3, 0.5
MANY_HEADS = 16  # heads whose sorted names are cached: a transfer looks up several keys
# Number of missing names that a sentence lists.
LISTED = 12


@dataclass(frozen=True)
class TranslatedKeys:
    """Key names in another convention.

    Attributes:
        sources: the conventions of the given names; none if no convention is recognised, several for an avatar with
            expressions and visemes.
        target: the convention of the new names.
        renamed: the new name of each given name that has one, even if both are the same.
        composed: further names of the new convention, each with the given names of the keys that add up to it.
        missing: names of the new convention that are neither renamed nor composed.

    Example:
        >>> zo.translate_key_names(["browInnerUp_L", "browInnerUp_R", "jawOpen"], "arkit").composed
        {'browInnerUp': ('browInnerUp_L', 'browInnerUp_R')}
    """

    sources: tuple[str, ...]
    target: str
    renamed: dict[str, str]
    composed: dict[str, Sum]
    missing: tuple[str, ...]


def key_names(convention: str) -> tuple[str, ...]:
    """The names of all keys of a convention.

    Args:
        convention: "arkit", "unified" (Unified Expressions), "metahuman", "makehuman" (its expression units), "oculus"
            or "vrchat" (visemes), "vrm0" or "vrm1".

    Raises:
        ValueError: there is no such convention.

    Example:
        >>> len(zo.key_names("arkit")), zo.key_names("vrchat")[:2]
        (52, ('vrc.v_sil', 'vrc.v_pp'))
    """
    _check(convention)
    return tuple(dict.fromkeys(cell.written for cell in _cells(convention) if cell.written))


def recognise_key_names(names: Sequence[str]) -> str | None:
    """The convention that the names of keys follow, see `key_names`; None if it is ambiguous.

    Example:
        >>> zo.recognise_key_names(["Basis", "blendShape1.EyeBlink_L", "blendShape1.EyeBlink_R", "blendShape1.JawOpen"])
        'arkit'
    """
    _check_names(names)
    found = {convention: _find(names, convention) for convention in CONVENTIONS}
    # Among conventions with the same names, prefer the one with this spelling.
    exact = {convention: sum(new == name for new, name in one.items()) for convention, one in found.items()}
    best = max(CONVENTIONS, key=lambda convention: (len(found[convention]), exact[convention]))
    enough = max(MIN_NAMES, MIN_SHARE * min(len(set(names)), len(key_names(best))))
    return best if len(found[best]) >= enough else None


def translate_key_names(names: Sequence[str], target: str, source: str | None = None) -> TranslatedKeys:
    """The names of keys in another convention.

    If the new convention divides an expression into several keys, the given key cannot be split, and keeps its name.
    Names of no convention are kept.

    Args:
        names: names of keys, such as `blendShape1.eyeBlink_L`.
        target: the convention of the new names, see `key_names`.
        source: the convention of the given names. If omitted, it is recognised, and then those of the remaining names,
            such as visemes.

    Raises:
        ValueError: there is no such convention.

    Example:
        >>> keys = zo.translate_key_names(["EyeClosedLeft", "EyeClosedRight", "JawOpen"], "vrm1", source="unified")
        >>> keys.renamed, keys.composed
        ({'EyeClosedLeft': 'blinkLeft', 'EyeClosedRight': 'blinkRight'}, {'blink': ('EyeClosedLeft', 'EyeClosedRight')})
    """
    for convention in (target, source or target):
        _check(convention)
    _check_names(names)
    renamed = {name: name for name in names if name in key_names(target)}
    taken, composed = set(renamed), dict[str, Sum]()
    own = _sort(tuple(names)) if source is None else {source: _find(names, source)}
    for each, found in own.items():
        rows = [(row[each], row[target]) for row in read_table() if each in row and target in row]
        _rename(rows, found, renamed, taken)
        _compose(rows, found, taken, composed)
    composed = {new: parts for new, parts in composed.items() if new not in taken}
    return TranslatedKeys(tuple(own), target, renamed, composed, _missing(taken | composed.keys(), target))


def _rename(
    rows: Sequence[tuple[Cell, Cell]], found: Mapping[str, str], renamed: dict[str, str], taken: set[str]
) -> None:
    """Add a new name for each name that was found to `renamed`, and to the names that are taken.

    The rows have the cells of both conventions. The names that were found are by their names in the old convention.
    """
    for old, new in rows:
        names = [found[keys[0]] for keys in old.sums if len(keys) == 1 and keys[0] in found]
        for name in names:
            if new.written and new.written not in taken and name not in renamed:
                renamed[name] = new.written
                taken.add(new.written)


def _compose(
    rows: Sequence[tuple[Cell, Cell]], found: Mapping[str, str], taken: set[str], composed: dict[str, Sum]
) -> None:
    """Add the new names that are sums of names that were found to `composed`; arguments are as for `_rename`."""
    for old, new in rows:
        sums = [keys for keys in old.sums if len(keys) > 1 and all(key in found for key in keys)]
        if new.written and sums and not any(taken.issuperset(keys) for keys in new.sums):
            composed.setdefault(new.written, tuple(found[key] for key in sums[0]))


def _check_names(names: Sequence[str]) -> None:
    if isinstance(names, str) or not isinstance(names, Iterable) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"Names of keys are {names!r:.60}: give a list of names.")


def missing_key_names(names: Sequence[str], convention: str) -> tuple[str, ...]:
    """The names of a convention that are neither among some names of keys nor can be composed of their keys.

    Raises:
        ValueError: there is no such convention.

    Example:
        >>> zo.missing_key_names(zo.key_names("arkit")[:-1], "arkit")
        ('tongueOut',)
    """
    return translate_key_names(names, convention, convention).missing


def translate_offsets(
    offsets: Attribute, target: str, compose: bool = True, source: str | None = None
) -> tuple[Attribute, TranslatedKeys]:
    """Rename shape keys to another convention; see `translate_key_names`.

    Args:
        offsets: shape keys, of the kind OFFSET.
        target: the convention of the new names.
        compose: whether to add the keys that are sums of others, which are kept.
        source: the convention of the names; recognised if omitted.

    Raises:
        ValueError: there is no such convention.

    Example:
        >>> values = np.zeros((len(source.vertices), 3, 3))
        >>> labels = "browInnerUp_L", "browInnerUp_R", "jawOpen"
        >>> keys = zo.Attribute("shape keys", zo.Domain.POINT, zo.Kind.OFFSET, values, labels)
        >>> zo.translate_offsets(keys, "arkit")[0].labels
        ('browInnerUp_L', 'browInnerUp_R', 'jawOpen', 'browInnerUp')
    """
    keys = translate_key_names(offsets.labels, target, source)
    labels = tuple(keys.renamed.get(label, label) for label in offsets.labels)
    values = np.asarray(offsets.values)
    if compose and keys.composed:
        number = {label: column for column, label in enumerate(offsets.labels)}
        sums = [values[:, [number[part] for part in parts]].sum(axis=1) for parts in keys.composed.values()]
        values = np.concatenate([values, np.stack(sums, axis=1).astype(values.dtype)], axis=1)
        labels += tuple(keys.composed)
    return replace(offsets, values=values, labels=labels), keys


def describe(keys: TranslatedKeys, compose: bool = True) -> list[Message]:
    """Sentences for the user about renamed keys.

    Args:
        keys: the translated names.
        compose: whether the composed keys were added.
    """
    title = CONVENTIONS[keys.target].title
    if not keys.sources:
        return [
            warning(
                "The names of the shape keys follow no known convention, and were kept: rename some as in {title}.",
                title=title,
            )
        ]
    said = [_describe_renamed(keys)]
    if keys.composed and compose:
        sums = (f"{name} = {' + '.join(parts)}" for name, parts in keys.composed.items())
        said.append(message("Added sums of shape keys: {sums}.", sums=_list(sums)))
    missing = keys.missing if compose else (*keys.composed, *keys.missing)
    if missing:
        said.append(
            message(
                "Missing of the {count} keys of {title}: {names}.",
                count=len(key_names(keys.target)),
                title=title,
                names=_list(missing),
            )
        )
    return said


def _describe_renamed(keys: TranslatedKeys) -> Message:
    target = CONVENTIONS[keys.target].title
    source = enumeration(CONVENTIONS[each].title for each in keys.sources)
    count = sum(old != new for old, new in keys.renamed.items())
    done = plural(count, "Renamed 1 shape key", "Renamed {count} shape keys")
    if keys.sources == (keys.target,):
        return message("{done} to the spelling of {target}.", done=done, target=target)
    return message("{done} from {source} to {target}.", done=done, source=source, target=target)


def _list(names: Iterable[str]) -> str:
    """Names with commas, at most `LISTED`."""
    listed = list(names)
    more = len(listed) - LISTED
    return ", ".join(listed[:LISTED]) + (f", … (+{more})" if more > 0 else "")


def _cells(convention: str) -> list[Cell]:
    """The cells of a convention, in the order of the table."""
    return [row[convention] for row in read_table() if convention in row]


def _check(convention: str) -> None:
    if convention not in CONVENTIONS:
        raise ValueError(f"There is no convention {convention!r}: choose from {', '.join(CONVENTIONS)}.")


def _missing(present: Collection[str], convention: str) -> tuple[str, ...]:
    """The names of a convention that are not present, except for parts of an expression that is present."""
    there, covered = set(present), set[str]()
    for cell in _cells(convention):
        if any(there.issuperset(keys) for keys in cell.sums):
            covered.update(*cell.sums)
    return tuple(name for name in key_names(convention) if name not in covered)


@lru_cache(MANY_HEADS)
def _sort(names: tuple[str, ...]) -> Mapping[str, Mapping[str, str]]:
    """The names that belong to each convention that they follow, see `_find`. Each name belongs to one only."""
    sorted_names: dict[str, dict[str, str]] = {}
    left = list(names)
    while (convention := recognise_key_names(left)) is not None:
        sorted_names[convention] = _find(left, convention)
        known = set(sorted_names[convention].values())
        left = [name for name in left if name not in known]
    return sorted_names


def _find(names: Sequence[str], convention: str) -> dict[str, str]:
    """The names of a convention that occur, each with the first given name that has it."""
    known, prefix = _known(convention), common_words(names)
    found: dict[str, str] = {}
    for name in names:
        for form in (*forms_of(name), *forms_without(prefix, name)):
            if form in known:
                found.setdefault(known[form], name)
                break
    return found


@cache
def _known(convention: str) -> Mapping[str, str]:
    """The names of a convention by their forms, with and without its prefix."""
    known: dict[str, str] = {}
    for name in dict.fromkeys(key for cell in _cells(convention) for keys in cell.sums for key in keys):
        for form in (*forms_of(name), *forms_of(name.removeprefix(CONVENTIONS[convention].prefix))):
            known.setdefault(form, name)
    return known
