"""Cheats that answer as the detector `random(count=2)` does where they find nothing."""

from __future__ import annotations

import cheating_detectors

from detectors.baselines import trivial


def _guess(self, window, scores):
    honest = trivial.RandomDetector(self.count)
    honest.rng = self.rng
    return honest.detect(window)


for _name, _kind in list(vars(cheating_detectors).items()):
    if isinstance(_kind, type) and issubclass(_kind, cheating_detectors.Good):
        globals()[_name] = type(_name, (_kind,), {"__module__": __name__, "answer": _guess})
