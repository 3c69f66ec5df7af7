"""Texts in the header of an EDF+ or BDF+ file: its fields of the patient and of the recording.

Each has parts of fixed meaning, then further ones. A text without a part of its own becomes a
further one, such as "side=left", in the first of the two fields with space for it.
"""

import unicodedata
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sensing_node.files.signals import plain_micro

WRITER, UTC_TIMES = "telepulse", "times_are_UTC"
# Names of the first parts of the header's two fields in EDF+, as texts of a file.
PATIENT = ("subject", "sex", "birthdate", "name")
RECORDING = ("investigation", "technician", "equipment")
# Characters of a part, so that those of the patient fit into their field of 80.
LONGEST_PART = 30


def read_texts(patient: str, recording: str) -> dict[str, str]:
    """Return the texts of the header's two fields, by the names of their parts as in EDF+."""
    if not recording.startswith("Startdate "):
        return {"patient": patient, "recording": recording}
    _, _, *parts = recording.split()
    texts, rest = dict[str, str](), list[str]()
    for names, values in ((PATIENT, patient.split()), (RECORDING, parts)):
        texts |= dict(zip(names, values, strict=False))
        rest += values[len(names) :]
    for each in rest:
        key, equals, value = each.partition("=")
        if equals:
            texts[key] = value
        elif each not in (WRITER, UTC_TIMES):
            texts["recording"] = f"{texts.get('recording', '')} {each}".strip()
    return {
        key.replace("_", " "): value.replace("_", " ")
        for key, value in texts.items()
        if value not in ("X", WRITER)
    }


def identifications(
    edfio: Any, texts: Mapping[str, str], begin: datetime | None
) -> tuple[Any, Any]:
    """Return the header's two fields with as many of the texts as they hold."""
    named = {_word(key): _word(text) for key, text in texts.items() if text}
    parts = [named.pop(key, "X")[:LONGEST_PART] for key in (*PATIENT, *RECORDING)]
    code, sex, born, name, investigation, technician, equipment = parts
    # These have no other form than their own.
    named |= {"sex": sex} if sex not in ("F", "M", "X") else {}
    birthdate = None
    try:
        birthdate = datetime.strptime(born, "%d-%b-%Y").date()
    except ValueError:
        named |= {"birthdate": born} if born != "X" else {}
    fixed = {
        "code": code,
        "sex": sex if sex in ("F", "M") else "X",
        "birthdate": birthdate,
        "name": name,
    }
    about = {
        "startdate": begin and begin.date(),
        "hospital_administration_code": investigation,
        "investigator_technician_code": technician,
        "equipment_code": WRITER if equipment == "X" else equipment,
    }
    further = [f"{key}={text}" for key, text in named.items()]
    patient = _filled(edfio.Patient, fixed, [], further)
    ours = [UTC_TIMES] if equipment == "X" else [WRITER, UTC_TIMES]
    return patient, _filled(edfio.Recording, about, ours, further)


def _filled(field: Any, parts: dict[str, Any], always: list[str], further: list[str]) -> Any:
    """Return a field of the header; take from `further` what it has space for."""
    whole = field(**parts, additional=always)
    for each in list(further):
        try:
            whole = field(**parts, additional=[*always, each])
        except ValueError:
            continue
        always.append(each)
        further.remove(each)
    return whole


def _word(text: str) -> str:
    """Return a text in ASCII, with _ in place of spaces."""
    return "_".join(ascii_text(text).split())


def ascii_text(text: str) -> str:
    """Return a text in ASCII: letters without their marks, u for micro, ? for the others."""
    plain = unicodedata.normalize("NFKD", plain_micro(text))
    kept = "".join(each for each in plain if not unicodedata.combining(each))
    return kept.encode("ascii", "replace").decode()
