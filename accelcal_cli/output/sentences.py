"""Every sentence for people, made from codes with values: of a recording, a study, its files and devices.

Nothing is judged here, and no program reads what is said."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from string import Formatter
from typing import Any

from accelcal_cli.core.errors import Reason, counted, listed, printable
from accelcal_cli.output.numbers import mg, number, times_smaller, with_error
from accelcal_cli.output.sections import HoldoutSection, ReportView

# Words for people about a study: what is found of its devices, and of its recordings among others.
#
# Nothing is judged here.

DEVICES = {
    "two_sensors": "{label} differs by {size} between {paths[0]} and {paths[1]}: two sensors under one "
    "serial?",
    "device_step": "{label} changes by {size} from {dates[0]} to {dates[1]}",
    "device_drift": "{label} drifts by {size} a month{doubt}",
    "device_level": "{label} is {size} (limit {limit:g} {unit})",
    "device_held_out": "held-out error {held_out_mg:.1f} mg (similar devices: {usual_mg:.1f} mg)",
    "device_refused": "{number} of {recordings} recordings refused or borrowed{elsewhere}",
    "device_damaged": "damage in {number} of {recordings} recordings, up to {lost_percent:.2g} % lost"
    "{elsewhere}",
    "device_not_known": "not known yet{best}; a recording of a day, at rest in many orientations, would tell",
}
"""Findings about a device, by code."""

SIZES = ("change", "per_month", "value")
"""Names of the value that a finding is about and that has an `error` and a `unit`."""


def of_device(reason: Reason) -> str:
    """Return what was found of a device; of a code that is not known, the code itself."""
    form = DEVICES.get(reason.code)
    return (
        reason.code if form is None else printable(form.format(**{**reason.values, **_parts(reason.values)}))
    )


def _parts(values: Values) -> Values:
    """Return parts of sentences that depend on several values."""
    parts = {"label": str(values.get("parameter")).replace("_", " ")}
    for name in SIZES:
        if name in values:
            parts["size"] = f"{with_error(values[name], values['error'])} {values['unit']}"
    uncertain = "per_month" in values and not values["certain"]
    parts["doubt"] = f" (not certain from {values['recordings']} recordings)" if uncertain else ""
    usual, high = values.get("elsewhere_percent"), values.get("least_high_mg")
    parts["elsewhere"] = "" if usual is None else f" (other devices: {usual:.0f} %)"
    parts["best"] = "" if high is None else f": the best recording may be {mg(high)} mg off"
    return {**parts, "dates": [(start or "")[:10] for start in values.get("starts", ())]}


KEPT = {
    "not_pooled": "Not pooled",
    "borrowed_nothing": "Borrowed nothing",
    "prior_not_learnt": "Kept with the prior of the population",
}
"""Why a recording keeps its own result although a later round was to replace it, by code."""


def kept(message: str, code: str, why: str) -> str:
    """Add to a message why its result stays."""
    return f"{message} {KEPT[code]}: {begun_small(why)}"


def copied(first: str) -> str:
    """Say that a recording has the bytes of another, whose path is given."""
    return f"a copy of {first}, which counts once"


def in_words(code: str) -> str:
    """Return a code as words."""
    return code.replace("_", " ")


def uncertain(error_mg: float | None, high_mg: float | None) -> str:
    """Say how large an uncertain calibration error may be."""
    if error_mg is None or high_mg is None:
        return "its error over all orientations is not certain"
    return f"{error_mg:.1f} mg over all orientations, but perhaps {high_mg:.1f} mg (95 %)"


def lost(percent: float) -> str:
    """Say how much of a file is lost."""
    return f"{percent:.2g} % of the file is lost"


def changed(kind: str, at: str | None, size_mg: float | None) -> str:
    """Say how a sensor changed while it recorded."""
    return sentence(Reason("sensor_changed", {"kind": kind, "at": at, "size_mg": size_mg or 0.0}))


def not_described(kinds: str) -> str:
    """Say which kinds of misfit were found."""
    return f"found: {kinds}"


SITES = ("wrist", "hip", "waist", "back", "sacrum", "thigh", "ankle", "chest", "arm", "leg", "foot")
"""Wear sites that are known if the name of a recording, or of its folder, has the word."""


def kind_of(path: str, model: str | None) -> str:
    """Return a device's model and the wear site, as far as the name of the file or of its folder has it."""
    words = re.split(r"[^a-z]+", "/".join(path.lower().replace("\\", "/").split("/")[-2:]))
    site = next((site for site in SITES if site in words), None)
    return ", ".join(filter(None, (printable(model or ""), site))) or "any device"


# Sentences about the files of a study: why one is left out, no longer belongs to it, or was decided
# on.
#
# Part of `SENTENCES`.

FormOfValues = str | Callable[[Mapping[str, Any]], str]
"""A sentence with names of values in braces, or a function of the values.

The values are those of a reason in `study.json`, which may have been changed by others.
"""


DECIDED = {"yes": "to use it", "with care": "to use it with care", "no": "not to use it"}


def _decided(values: Mapping[str, Any]) -> str:
    """Say what a person decided about a recording, and the person's note."""
    who_and_when = ", ".join(filter(None, (values["who"], values["when"])))
    note = f": {values['note'].rstrip('.')}" if values["note"] else ""
    by = f" ({who_and_when})" if who_and_when else ""
    return f"A person decided {DECIDED[values['decided']]}{by}{note}."


def _no_decision(values: Mapping[str, Any]) -> str:
    """Say what is wrong with a row of decisions."""
    if values["column"] == "recording":
        return f"Row {values['row']} names no recording."
    return f"In row {values['row']}, use is '{values['cell']}', which is not yes, with care or no."


def _share_missing(percent: float) -> str:
    return f", {percent:.2g} % of it is missing" if percent else ""


def _others(values: Mapping[str, Any]) -> list[str]:
    return [f"{values['more']} more"] if values.get("more") else []


def _mixed_times(values: Mapping[str, Any]) -> str:
    """Warn against joining the Parquet files of a study."""
    return (
        f"Times are in UTC in {counted(values['utc'], 'Parquet file')}, and in local time of an unknown zone "
        f"in {values['unknown']} (see time_zone in the table). Do not join them. Give the unknown zone with "
        "--timezone, in a separate study if other files state their own."
    )


FILES: dict[str, FormOfValues] = {
    # why a file of a study is left out
    "unfinished_copy": "It is a download or a copy that is not finished ({suffix}).",
    "excluded": "It is excluded by {by}.",
    "belongs_to_another": "It belongs to the recording {name}.",
    "not_a_file": "It is a pipe or a device, not a file.",
    "not_looked_into": "It could not be looked into ({fault}).",
    "archive_without_recordings": "No file in the archive is named like a recording.",
    "epochs": "It holds {whose} epochs, not raw acceleration.",
    "other_kind": "It is {what}.",
    "database": "It is an SQLite database, from which the recording can be exported as text (CSV).",
    "still_windows": "It holds means of still windows, which accelcal fit takes.",
    "no_acceleration": "Nothing in it is acceleration.",
    "other_quantities": lambda values: (
        f"It is a table of other quantities: {', '.join(map(str, values['columns']))}."
    ),
    "no_numbers": "It is text without rows of three or more numbers.",
    "no_format": "Its content matches no format.",
    # results whose recording is gone
    "recording_gone": "Its recording {source} is gone.",
    "recording_elsewhere": "Its recording {source} was in {folder}, not in a folder of this study.",
    "recording_renamed": "Its recording {source} is now called {now}.",
    "sensor_gone": "The sensor {sensor} is no longer in its file {source}.",
    # what a person decided
    "decided_by_a_person": _decided,
    "decision_outdated": "The result of {recording} has changed since row {row} decided {decided}. "
    "The more cautious of both counts: {use}.",
    "decision_followed": "Row {row} excludes {recording}, which is now called {now} and stays excluded. "
    "Write the new name.",
    "decision_without_data": "Row {row} decides {decided} on {recording}, which has no calibrated data. It "
    "stays {use}.",
    "decision_unreadable": _no_decision,
    "decision_without_recording": "Row {row} names {recording}, which is not a recording of the study.",
    "decisions_contradict": lambda values: (
        f"Rows {listed([*map(str, values['rows']), *_others(values)])} contradict each other on "
        f"{values['recording']}. The most cautious of them counts: {values['use']}."
    ),
    "decisions_gone": "The file is gone, and {number:n decision} with it. Put it back. If no decision is to "
    "count any more, write a file with the line recording,use alone.",
    # what else a person must act on in a study
    "disk_may_be_away": "No recording of the last run is left in this folder, or it is on another disk than "
    "then. The results stay ({results:n recording}). Mount the disk, or remove the folder if its recordings "
    "are really gone.",
    "file_cut_short": lambda values: (
        f"The file is cut short{_share_missing(values['lost_percent'])}. Copy it again from the device."
    ),
    "copied_under_another_name": "It has the same bytes as {first}, under another name. Find out whose "
    "recording it is, and exclude the other one in decisions.csv.",
    "pool_refused": "The {recordings} recordings of device {device_serial} are not pooled: {message}",
    "times_mixed": _mixed_times,
}
"""Sentences by code; words in braces are values of the reason."""


# Words for people about a report: numbers, what an outcome means, what to beware of, and what to do.
#
# Sentences for the terminal and for pages. All of them follow from the report; nothing is judged
# here.

Values = Mapping[str, Any]

PARAMETERS = {
    **{f"k_{axis}{axis}": f"scale of {axis}" for axis in "xyz"},
    **{f"k_{row}{of}": f"misalignment: {of} in {row}" for row in "xyz" for of in "xyz" if row != of},
    **{f"o{axis}": f"offset of {axis} [g]" for axis in "xyz"},
    **{f"q{axis}": f"bend of {axis} [per g]" for axis in "xyz"},
    **{f"s{axis}": f"change of the offset of {axis} [g per °C]" for axis in "xyz"},
}
"""Meaning of each parameter of a calibration."""

MODELS = {
    "0": "no correction",
    "3": "offsets",
    "6": "scales and offsets",
    "9": "scales, misalignments and offsets",
    "12": "the full gain matrix and offsets",
}
"""Corrections that each model makes, slopes by temperature aside."""

NUMBERS_OF_PARAMETERS = {"3": "three", "6": "six", "9": "nine", "12": "twelve"}


@dataclass(frozen=True, slots=True)
class OutcomeWords:
    """Meaning of an outcome.

    Attributes:
        result: words on a result's line; headline: words at the beginning of a page, if they differ.
        to_do: what to do with the recording, a sentence.
        use: what to do with the recordings of a study, in a few words.
        usable: there is a calibrated recording, or one that needs no calibration.
    """

    result: str
    to_do: str
    use: str
    headline: str = ""
    usable: bool = True


OUTCOMES = {
    "calibrated": OutcomeWords("calibrated", "Use the calibrated recording.", "use them"),
    "provisional": OutcomeWords(
        "calibrated provisionally",
        "Use the calibrated recording with care: it is probably better than the raw data, but this, or an "
        "error within the limit, is not certain enough.",
        "use them with care: probably better than the raw data, but the error may exceed the limit",
    ),
    "reduced_model": OutcomeWords(
        "calibrated in part",
        "Use the calibrated recording; the reason says which corrections were left out.",
        "use them; a simpler model was fitted",
    ),
    "already_good": OutcomeWords(
        "good as it is",
        "Use the recording as it is: a calibration would not clearly be better.",
        "use them as they are: the raw data were good",
        headline="good as it is, no correction needed",
    ),
    "borrowed": OutcomeWords(
        "calibrated with another recording's coefficients",
        "Compare the errors before and after, on its own still windows, before you use it.",
        "use them; the coefficients are those of another recording of the device",
    ),
    "refused": OutcomeWords(
        "refused",
        "Do not use this recording as calibrated; no calibrated data were written.",
        "not calibrated",
        usable=False,
    ),
    "failed": OutcomeWords("failed", "", "could not be read or processed", usable=False),
}
"""Outcomes of a study's recordings, the best first; reports have all but `failed`."""


def outcome_words(outcome: str) -> OutcomeWords:
    """Return what an outcome means; of one that is not known only its name."""
    return OUTCOMES.get(outcome) or OutcomeWords(outcome, "", "")


def parameters_of(model: str) -> str:
    """Name a model by its parameters: `nine parameters and temperature`."""
    number_of = NUMBERS_OF_PARAMETERS.get(model.removesuffix("T"))
    if number_of is None:
        return f"model {model}"
    return f"{number_of} parameters{' and temperature' if model.endswith('T') else ''}"


def corrections_of(model: str) -> str:
    """Name a model by what it corrects: `scales and offsets, with slopes by temperature`."""
    base = MODELS.get(model.removesuffix("T"), model)
    return f"{base}, with slopes by temperature" if model.endswith("T") else base


def _quietest(values: Values) -> str:
    if "windows" not in values:
        return ""
    which = f": the quietest of {counted(values['windows'], 'window')} of {values['seconds']:g} s"
    limit, measured = values["limit_g"], values["measured_g"]
    if values["quietest"] == "range":
        return f"{which} varies by {measured:.3g} g (the limit is {limit:g} g)"
    limited = "" if limit is None else f" (the limit is {1000 * limit:g} mg)"
    return f"{which} has a standard deviation of {1000 * measured:.3g} mg{limited}"


def _subsets(values: Values) -> str:
    """Say which of the paper's subsets lack points."""
    apart = f", at least {values['apart_g']:g} g apart" if values["apart_g"] else ""
    return (
        f"Profile paper needs {counted(values['points'], 'still window')} near -1, 0 and +1 g on each axis"
        f"{apart}. Missing in the {values['of']} set: {listed(values['subsets'])}."
    )


def _stuck(values: Values) -> str:
    turned = [f"{axis} by {by:.2f} g" for axis, by in zip(values["others"], values["by_g"], strict=True)]
    return (
        f"The {values['axis']} axis stays at {values['at_g']:.2f} g at rest while gravity moves "
        f"{listed(turned)}. Check that {values['axis']} is the right column or field."
    )


def _learnt_from(values: Values) -> str:
    devices, own = values["devices"], values["own"]
    others = [f"{counted(own, 'other recording')} of the device"] if own else []
    if devices or not own:
        others.append(f"{counted(devices, 'other device')} of model {values['model'] or ''}".rstrip())
    return listed(others)


def _known_fault(values: Values) -> str:
    shipped = ""
    if values["shipped_from"] is not None:
        shipped = f" if they were shipped from {values['shipped_from']} to {values['shipped_to']}"
    fault, name, source = values["fault"], values["name"], values["source"]
    return f"Devices of this kind, with this firmware, may have a fault{shipped}: {fault} ({name}, {source})."


def _cut_short(values: Values) -> str:
    if values["missing_bytes"] is None:
        return "The file breaks off: it is cut short or damaged. Copy it again from the device."
    share = "" if values["missing_percent"] is None else f" ({values['missing_percent']:.3g} %)"
    return (
        f"The file is cut short: at least {counted(values['missing_bytes'], 'byte')}{share} of it are "
        "missing. Copy it again from the device."
    )


def _misfit(values: Values) -> str:
    sizes = zip("xyz", values["size"], strict=True)
    shown = ", ".join(f"{axis} {value:.2g}" for axis, value in sizes)
    what = {
        "cubic": f"Its response is bent, with the cube of the acceleration ({shown} % at 1 g)",
        "gain by temperature": f"Its scales change with temperature ({shown} % per °C)",
        "curved by temperature": f"Its offsets follow temperature on a curve ({shown} mg per °C²)",
        "previous posture": f"Its values depend on the orientation before ({shown} mg per g)",
    }.get(values["kind"], f"{values['kind']} ({shown})")
    return (
        f"The sensor behaves in a way that calibration cannot correct. {what}, by up to "
        f"{values['largest_mg']:.1f} mg. If the device's other recordings show the same, have it checked."
    )


def _changed(values: Values) -> str:
    when = _to_second(values["at"])
    what = {
        "drift": "its offsets drift",
        "step": f"its offsets jump at {when}",
        "gain": f"its scales jump at {when}",
        "device": f"all its errors jump at {when}, as if another device had taken over there",
        "walk": "its offsets wander",
    }.get(values["kind"], values["kind"])
    text = f"The sensor changed during the recording: {what}, by up to {values['size_mg']:.1f} mg."
    if values.get("followed") is None:  # in a study's table
        return text
    if values["followed"] and values.get("left_percent") is not None:
        left = f"with a probability of {values['left_percent']:.0f} % it changed by more"
        return f"{text} The calibration follows it only in part: {left}."
    if values["followed"]:
        return f"{text} The calibration follows it."
    return (
        f"{text} In the recorded orientations one calibration for all of the recording leaves "
        f"{mg(values['constant_mg'])} mg, one that follows the sensor would leave "
        f"{mg(values['changing_mg'])} mg."
    )


def _rolled(values: Values) -> str:
    before, after = values["before_mg"], values["after_mg"]
    shown = f"{before['mean']:.1f} mg (SD {before['sd']:.1f})"
    if after is not None:
        shown += f" before and {after['mean']:.1f} mg (SD {after['sd']:.1f}) after calibration"
    return f"Rolled with {values['axis']} level, {values['axis']} shows {shown}."


def _no_longer_fits(values: Values) -> str:
    """Say from when to when coefficients do not fit."""
    error, new = mg(values["error_mg"]), mg(values["new_mg"])
    since, until = (_to_second(values[name]) for name in ("since", "until"))
    span = f"From {since}" if since else "From the beginning"
    span += f" to {until}" if until else " on"
    return f"{span} their error is {error} mg. A new calibration would leave {new} mg. Find new coefficients."


def _to_second(time: str | None) -> str:
    return (time or "").partition(".")[0]


SENTENCES: dict[str, str | Callable[[Values], str]] = {
    # outcomes
    "calibrated": "Calibration error over all orientations: {raw_mg:mg} mg before, {error_mg:mg} mg after "
    "(95 % interval {low_mg:mg} to {high_mg:mg} mg), lower than before with a probability of {percent:.0f} % "
    "or more. Error |r - 1| on held-out {held_out}: {before_mg:mg} mg before, {after_mg:mg} mg "
    "after{times_smaller}.",
    "provisional": "Calibration error over all orientations: {raw_mg:mg} mg before, {error_mg:mg} mg after "
    "(95 % interval {low_mg:mg} to {high_mg:mg} mg, the limit is {limit_mg:g} mg). The data are better "
    "than raw with a probability of {percent:.0f} % or more, in {orientations:n recorded orientation} and "
    "over all orientations.",
    "calibrated_held_out": "{model_asked_for}: the error |r - 1| on held-out {held_out} is {before_mg:mg} mg "
    "before and {after_mg:mg} mg after{times_smaller}.",
    "calibrated_in_part": "{model_asked_for}: the error |r - 1| on held-out {held_out} is {before_mg:mg} mg "
    "before and {after_mg:mg} mg after{times_smaller}.{left_out_because}",
    "not_clearly_better": "A calibration is better than the raw data with a probability of only "
    "{percent:.0f} %. Calibration error over all orientations: {raw_mg:mg} mg before, {error_mg:mg} mg after "
    "(95 % interval {low_mg:mg} to {high_mg:mg} mg, {orientations:n recorded orientation}).",
    "raw_no_worse": "No model is clearly better than the raw data, which are {before_mg:mg} mg off on "
    "held-out {held_out}.",
    "calibrated_before": "The recording is {origin}. It was not fitted again: its own still windows are "
    "{before_mg:mg} mg off ({orientations:n orientation}).",
    "calibrated_before_unchecked": "The recording is {origin}. There is no still window to check that.",
    "borrowed": "The coefficients are those of {path} (sha256 {sha256}, device {device}). {errors_here}",
    "pooled": "The coefficients were fitted to {recordings} recordings of device {serial} together. {pool} "
    "{errors_here}",
    "poses_calibrated": "Model 12: {norm_before_mg:mg} mg before, {norm_after_mg:mg} mg after, on held-out "
    "orientations, and with the direction {before_mg:mg} and {after_mg:mg} mg.{unchecked_faces}",
    "poses_unchecked": "Model 12 was fitted to {orientations:n orientation}, and nothing was held out: its "
    "error is not known. The raw data are {before_mg:mg} mg off, direction included.",
    "poses_no_better": "The raw data are {before_mg:mg} mg off, no more than twelve parameters leave on "
    "held-out orientations: {after_mg:mg} mg.",
    # refusals
    "nothing_still": lambda values: f"No still window was found{_quietest(values)}.",
    "nothing_measured": "No still window was found: there are no {seconds:g} s without a gap.",
    "still_far_from_1_g": lambda values: (
        "The still windows are far from 1 g"
        + (f" (typically {values['median_g']:.3g} g)." if "median_g" in values else ".")
    ),
    "nothing_but_filled": "No still window was found: {filled_percent:.1f} % of the samples are filled, "
    "such as rows of zeros. The device did not measure then.",
    "nothing_near_quietest": "No other window comes near the quietest one of the recording.",
    "constant_values": "Every still window holds one constant value: the sensor was off or asleep, "
    "or its counts are coarser than its noise.",
    "nothing_but_saturated": "In every still window an axis stays at one value, beyond which it seems to "
    "measure nothing.",
    "too_few_orientations": "The device was still in only {orientations:n orientation}, and at least "
    "{needed} are needed.",
    "fit_diverges": "The optimizer came to no minimum.",
    "beyond_range": "The still windows are too far from 1 g for the fit: an axis seems to have another "
    "scale.",
    "calibration_error_over_limit": "The calibration error over all orientations may be {error_mg:mg} mg "
    "(95 % interval {low_mg:mg} to {high_mg:mg} mg). The limit is {limit_mg:g} mg.",
    "held_out_error_over_limit": "The best model ({model}) leaves {after_mg:mg} mg on held-out {held_out}. "
    "The limit is {limit_mg:g} mg.",
    "not_better": "{model_asked_for}, does not improve the recording: {before_mg:mg} mg before, "
    "{after_mg:mg} mg after, on held-out {held_out}.",
    "model_not_fitted": "Model {model} cannot be fitted: {why}",
    "no_model_tried": "No model could be fitted: {why}",
    "model_uncertain": "Model {model} cannot be trusted: {why}",
    "subsets_not_full": _subsets,
    "damaged": "{lost_percent:.1f} % of the recording is lost to damage ({lost_bytes} bytes). The limit is "
    "{limit_percent:g} %.",
    "recordings_contradict": "The recordings of the pool contradict each other. In {path} {why}",
    "poses_disagree": "The poses disagree: {after_mg:mg} mg on held-out orientations, where the limit is "
    "{vector_limit_mg:g} mg, and {norm_after_mg:mg} mg in length, where it is {limit_mg:g} mg. The worst is "
    "{worst} at {start_s:.0f} s with {worst_mg:.0f} mg, unless its opposite is the cause. A tilt of 1 "
    "degree makes 17.5 mg.",
    "no_point_near_1_g": "No point is anywhere near 1 g. The columns x, y and z must be in g.",
    "no_points": "The table holds no points.",
    # why coefficients were not taken
    "worse_than_usual": "{before_mg:mg} mg become {after_mg:mg} mg in {orientations:n orientation} of its "
    "own, and {usual_mg:mg} mg are usual in the pool.",
    "over_limit_here": "{before_mg:mg} mg become {after_mg:mg} mg in {orientations:n orientation} of its "
    "own, and the limit is {limit_mg:g} mg.",
    "not_less": "{before_mg:mg} mg become {after_mg:mg} mg in {orientations:n orientation}, which is not "
    "less.",
    "own_is_no_worse": lambda values: (
        f"Its own calibration leaves {mg(values['own_mg'])} mg, and "
        + (
            "the error with these coefficients is unknown."
            if values["after_mg"] is None
            else f"these coefficients {mg(values['after_mg'])} mg, no less beyond the uncertainty."
        )
    ),
    "not_tried": "It could not be tried ({message}).",
    "donor": "With the coefficients of {path}: {why}",
    "untested": "There is no still window in {needed} orientations to test coefficients on.",
    "unlike_prior": "Its still windows contradict what other recordings say of its sensor.",
    "left_out_of_pool": "It was left out of the pool: {why}",
    # why a model was not used
    "not_determined": "The still windows do not determine it.",
    "uncertain_somewhere": "Its error could reach {by_mg:.0f} mg in some orientations.",
    "temperature_too_even": "The temperature varies by {range_c:.2g} °C, and at least {least_c:g} °C "
    "are needed.",
    "few_orientations_differ_in_temperature": "Too few orientations were recorded at different temperatures.",
    "no_stillness_on_sides": "No still window has {sides:list} pointing up ({reach_g:g} g or more).",
    "no_stillness_along": "There is no still window with {axes:list} beyond +-{reach_g:g} g.",
    "optimizer_never_fits": "Optimizer {optimizer} fits no {what}.",
    "nothing_held_out": "Nothing was held out, so the error is not known.",
    # notes
    "unlike_most_sensors": "The sensor is farther off than most ({parameters:list}).",
    "axes_alike": "The axes {axes:list} hold the same values throughout. Give each axis its own "
    "column or field.",
    "axis_stuck": _stuck,
    "gravity_is_zero": "There is no gravity in the values: they were filtered, or are linear acceleration, "
    "which cannot be calibrated. Give the file, or the columns, of the acceleration with gravity.",
    "wrong_unit": "{of_what} {median_g:.3g} g instead of 1 g, as if values in {unit} were read as "
    "{read_as}. Use --unit {unit}.",
    "not_1_g": "{of_what} {median_g:.3g} g instead of 1 g. Check the unit (--unit) and the columns "
    "(--columns).",
    "wrong_counts_per_g": "{of_what} {median_g:.3g} g instead of 1 g. {fits:.4g} counts per g would fit "
    "instead of {lsb_per_g:.6g}: check --lsb-per-g and the layout.",
    "rest_scatters": "Gravity measures anything from {low_g:.2f} to {high_g:.2f} g at rest, more than "
    "offsets explain. An axis may have another scale: check its unit and range, the columns, or the places "
    "and types of the fields.",
    "prior_learnt": lambda values: f"The prior was learnt from {_learnt_from(values)}.",
    "other_stillness": "By the x axis alone this recording would be refused. It was judged with "
    "{options} instead.",
    "windows_repeated": "{windows:n still window} that repeat earlier ones exactly were left out.",
    "own_coefficients": "These are the recording's own coefficients.",
    "other_device": "This recording's device is {serial}.",
    "other_model": "This recording's device is of model {model}, with the same serial.",
    "other_counts_per_g": "The recording has {here:.10g} counts per g, that of the coefficients "
    "{there:.10g}.",
    "factory_calibration_differs": lambda values: (
        "The maker's calibration was applied first to this recording, and not to that of the coefficients."
        if values["applied_here"]
        else "The maker's calibration was applied first to the recording of the coefficients, and not to "
        "this one."
    ),
    "slopes_left_out": "The coefficients are used as at {at_c:.1f} °C, without their temperature slopes.",
    "rolled": _rolled,
    # gyroscope
    "gyroscope_calibrated": "The scale was fitted to {turns:n turn} between rests. On held-out turns "
    "gravity is {after_deg:.2g} degrees off, {before_deg:.2g} before.{unusual_scale}",
    "gyroscope_by_revolutions": "The scale was fitted to {revolutions:n whole revolution} about the "
    "vertical. On {turns:n turn} between faces gravity is {after_deg:.2g} degrees off, "
    "{before_deg:.2g} before.",
    "gyroscope_never_at_rest": "The gyroscope is never at rest for a second together with the accelerometer.",
    "accelerometer_not_calibrated": "The accelerometer has no calibration to compare the gyroscope with.",
    "scale_not_determined": "The turns do not determine the scale.",
    "gravity_still_off": "On held-out turns gravity is still {after_deg:.2g} degrees off. Units, axes or "
    "times of the gyroscope may be wrong.",
    "wrong_unit_of_rates": lambda values: (
        "The rates are about "
        + (
            f"{values['factor']:.2g} times too small"
            if values["factor"] > 1
            else f"{1 / values['factor']:.2g} times too large"
        )
        + " for the turns. Check their unit."
    ),
    "too_little_turning": "There is too little turning about {axis}: the standard error of its scale is "
    "{standard_error:.2g}.",
    "scale_no_better": "A scale matrix is no better on held-out turns ({before_deg:.2g} degrees before).",
    "too_few_turns": "There are only {turns:n turn} of at least {least_deg:g} degrees from one rest to "
    "another within 30 s, and {needed} are needed.",
    "turns_miss_an_axis": "The turns do not span all axes: there are hardly any about {axis}.",
    # whether coefficients of another recording fit all the time
    "no_longer_fits": _no_longer_fits,
    "error_rises": "From {since:time} on their error is {error_mg:mg} mg, before that {before_mg:mg} mg. "
    "That is too short to tell a change of the sensor from a new orientation.",
    # no change was looked for
    "too_short": "The recording is too short to show a change of the sensor.",
    "too_many_cells": "The recording holds too many orientations and temperatures to compare them over time.",
    "few_still_stretches": "The device was still in too few stretches of time to show a change.",
    # cautions
    "cut_short": _cut_short,
    "filled_share": "{filled_percent:.1f} % of the samples are filled: the device did not measure then (idle "
    "sleep, or rows of zeros). They take no part in the calibration or in means.",
    "rows_without_values": "{empty_percent:.1f} % of the rows hold no values ({empty_rows:n row}), as where "
    "the device was not worn. They count as gaps.",
    "unlikely_year": "The recording begins in {start:time}, as if its clock was never set or overflowed. "
    "Correct its times with -R shift=SECONDS. The calibration does not need them.",
    "clock_reset": "The clock was reset: it jumps from {before:time} to {after:time} at sample {sample} "
    "({resets:n reset} in all). Times on one side of that are wrong. The calibration does not need them.",
    "scatter_over_limit": "The still windows scatter by {scatter_mg:mg} mg: slow movement may have passed as "
    "stillness (--stillness), or the sensor may be faulty.",
    "known_fault": _known_fault,
    "axis_saturates": "The {axis} axis saturates at {at_g:.2f} g: it measures nothing beyond.",
    "misfit": _misfit,
    "sensor_changed": _changed,
    "may_have_changed": "The sensor changed during the recording with a probability of {percent:.0f} %, most "
    "probably about {at:time}. The interval counts that.",
    "change_not_looked_for": "A change of the sensor was not looked for: a table of windows has no times.",
    "give_latitude": "Say where the device was, since gravity differs by place (--latitude).",
    "cut_recording": "Cut the recording where the sensor changed, and calibrate the parts.",
    "error_may_reach": lambda values: (
        f"The error may be {mg(values['high_mg'])} mg on average"
        f"{' over all orientations, and more in single ones' if values['everywhere'] else ''}. "
        "Do not rely on it where a few mg matter."
    ),
    "no_better_than_raw": "The calibrated data may be no better than the raw data: the interval includes "
    "the error before calibration ({before_mg:mg} mg).",
    "not_converged": "The fit stopped after {iterations:n iteration}, before it had reached its minimum.",
    "sides_unchecked": "Orientations missing at rest, by the axis that points up: {sides:list}. The "
    "calibration is not validated in {that}.",
    "nothing_checks_poses": "Nothing was held out: no error is known, and a wrong pose would not show. Add "
    "poses, or roll the device with one axis level (six-pose --roll).",
    "roll_alone_checks_poses": "Nothing was held out: only the roll speaks for this calibration.",
    "worse_here": "The error is larger with these coefficients than without.",
    "much_left": "With these coefficients the error is still {limit_mg:g} mg or more.",
    # advice
    "record_longer": "Record longer, with more turns of the wrist.",
    "more_orientations": "The device was still in only {orientations:n orientation}: turn it more often.",
    "rest_on_sides": "Orientations missing at rest, by the axis that points up: {sides:list}. Take the "
    "device off and leave it in {each} for a minute.",
    "orientations_disagree": "{orientations:n orientation} disagree by {by_mg:mg} mg: slow movement may "
    "have passed as stillness (--stillness), or the sensor may be faulty.",
    "check_unit": "Check the unit: use --unit, or --lsb-per-g if the values are counts.",
    "check_sensor": "Check that the sensor was on, and that --columns names the acceleration.",
    "other_rule": "Use another rule of --stillness.",
    "adaptive_rule": "If that is the sensor's noise, use --stillness adaptive.",
    "shorter_windows": "If the device rested for shorter times only, use a smaller --segment-seconds.",
    "shorter_windows_or_longer_gaps": "Use a smaller --segment-seconds or a larger --longest-gap.",
    "use_options": "Use {options}, which calibrates this recording.",
    "use_optimizer": "Use --optimizer {optimizer}: the points are good enough for it.",
    "use_default_profile": "Use --profile default, which needs no full subsets.",
    "copy_again": "Copy the file again from the device.",
    "allow_damage": "To use what is left, allow more damage, such as -R max_damage=70.",
    "omit_strict": "To use the calibration provisionally, omit --strict.",
    "rest_on_faces": "Rest the device exactly on its faces, on a level surface.",
    "check_references": "Check the references and their times.",
    "record_again": "Record again: the device has to lie still for some seconds, in different orientations.",
    "other_coefficients": "Use coefficients from another recording of this device (accelcal apply, or "
    "accelcal study --borrow), or calibrate the device itself (accelcal six-pose).",
    **FILES,
}
"""Sentences of the codes of reasons: formats of their values, or functions of them."""


def _left_out(values: Values) -> str:
    why = PHRASES["why"][1](values) if values.get("why") else "the held-out error is no lower with it."
    return f" It leaves {values['left_out']} out: {why}" if values["left_out"] else ""


def _unchecked_faces(values: Values) -> str:
    faces, missing = values["unchecked"], values.get("missing")
    named = f" (missing: {listed(missing)})" if missing else ""
    return f" Nothing checks {listed(faces)}, without which there is no fit{named}." if faces else ""


PHRASES: dict[str, tuple[str, Callable[[Values], Any]]] = {
    "why": ("why", lambda values: begun_small(sentence(Reason(**values["why"])))),
    "pool": ("pool", lambda values: sentence(Reason(**values["pool"]))),
    "model_asked_for": (
        "model",
        lambda values: f"Model {values['model']}{', as asked for' if values.get('asked_for') else ''}",
    ),
    "of_what": (
        "of",
        lambda values: "Gravity measures" if values["of"] == "rest" else "The median of |a| is",
    ),
    "that": (
        "sides",
        lambda values: "that orientation" if len(values["sides"]) == 1 else "those orientations",
    ),
    "each": (
        "sides",
        lambda values: "that orientation" if len(values["sides"]) == 1 else "each of those orientations",
    ),
    "parameters": (
        "parameters",
        lambda values: [PARAMETERS.get(one, one).partition(" [")[0] for one in values["parameters"]],
    ),
    "left_out_because": ("left_out", _left_out),
    "unusual_scale": (
        "unusual",
        lambda values: (
            " The scale is far from 1: check the units and the axes of the gyroscope."
            if values["unusual"]
            else ""
        ),
    ),
    "unchecked_faces": ("unchecked", _unchecked_faces),
}
"""Parts of sentences: the value without which there is no such part, and how it is made."""


class _Words(Formatter):
    """Formats values for sentences: `n NOUN` counts, `list` joins, `mg` writes an error."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        if format_spec.startswith("n "):
            return counted(value, format_spec[2:])
        if format_spec == "time":
            return _to_second(value)
        if format_spec == "list":
            return listed(list(map(str, value)))
        return mg(value) if format_spec == "mg" else super().format_field(value, format_spec)


def sentence(reason: Reason) -> str:
    """Return the sentence of a reason; the code itself if that is not known, or its values do not fit."""
    form, values = SENTENCES.get(reason.code), reason.values
    made = reason.code
    if form is not None:
        with suppress(LookupError, TypeError, ValueError, AttributeError, OverflowError):  # a changed report
            made = (
                form(values) if callable(form) else _Words().vformat(form, (), {**values, **_phrases(values)})
            )
    return printable(made)


def clause(reason: Reason) -> str:
    """Return the sentence of a reason as a part of another: without capital and full stop."""
    return begun_small(sentence(reason)).removesuffix(".")


def begun_small(text: str) -> str:
    """Return a sentence that continues after a colon."""
    return text[:1].lower() + text[1:]


def _phrases(values: Values) -> Values:
    """Return parts of sentences that depend on several values."""
    always = {"times_smaller": times_smaller(values.get("factor"), values.get("factor_ci95"))}
    always |= {"errors_here": _errors_here(values), "left_out_because": "", "unusual_scale": ""}
    found = {name: make(values) for name, (of, make) in PHRASES.items() if values.get(of) is not None}
    return {**always, "unchecked_faces": "", **found}


def _errors_here(values: Values) -> str:
    if values.get("orientations") is None:
        return "The recording has still windows in fewer than two orientations to check them."
    number = counted(values["orientations"], "orientation")
    before, after = mg(values.get("before_mg")), mg(values.get("after_mg"))
    return f"On its own still windows: {before} mg before, {after} mg after ({number})."


def explained(reason: Reason, notes: Sequence[Reason] = ()) -> str:
    """Return a reason and notes in sentences."""
    return " ".join(map(sentence, (reason, *notes)))


def message(report: ReportView) -> str:
    """Return why a report's outcome is what it is, in sentences."""
    return explained(Reason(report.reason, report.values), report.notes)


def error_sentence(report: ReportView) -> str:
    """Return the number to quote, in a sentence."""
    everywhere, holdout, known = report.calibration_error_mg, report.holdout, report.known_orientations
    if everywhere is not None:
        low, high = everywhere.ci95
        better = ""
        if report.probability is not None and report.outcome != "already_good":
            percent = min(99, int(100 * report.probability.better_than_raw))
            better = f" It is lower than that of the raw data with a probability of {percent} % or more."
        return (
            f"Calibration error over all orientations {number(everywhere.mean, 2)} mg "
            f"(95 % interval {number(low, 2)} to {number(high, 2)} mg; "
            f"raw data {number(everywhere.before)} mg).{better}"
        )
    if known is not None and known.holdout_vector_mg is not None:
        after, before = known.holdout_vector_mg.after.mean, known.holdout_vector_mg.before.mean
        held_out = "mg on held-out orientations, direction included"
        return f"Error {number(after)} {held_out} (raw data {number(before)} mg)."
    if holdout is not None:
        before, after = holdout.before_mg.mean, holdout.after_mg.mean
        return (
            f"Error {number(after)} mg on held-out orientations (raw data {number(before)} mg)"
            f"{smaller_by(holdout)}."
        )
    return "Its error is not known."


def smaller_by(holdout: HoldoutSection) -> str:
    """Return how many times smaller a held-out error became, as the end of a sentence."""
    factor = holdout.improvement_factor
    return "" if factor is None else times_smaller(factor.value, factor.ci95)
