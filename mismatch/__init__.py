"""Mismatch: which physics a simulation leaves out that a recording shows.

`rig` reads what an engineer knows, `effects` what may be missing; `model` runs the plant with effects over a recording,
and `fit` fits it. `search` ranks and fits hypotheses, `selection` chooses among them, `diagnosis` says what was found.
`claims` refuses what fails a gate (`intervals`, `blocks`, `adequacy`), and `ruled_out` bounds what is not there.
`runs` and `several` join several recordings of one machine, `shown_by` says which of them shows an effect, `uneven`
resamples. `coloured` and `coloured_selection` serve recordings whose noise is not stated. `closure` finds terms that no
effect has, `formula` writes them, `accepted` keeps them; `locate` says where a mismatch acts. `experiments` proposes
what to record next. `concealed` makes cases with a known answer, by equations of its own.
"""
