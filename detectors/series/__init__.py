"""The lagged time-series kernel: designs, gaps, regressions over all pairs, null models, surrogates, evidence, votes.

Every detector that asks whether one UAV's past predicts another UAV's velocity stands on these modules. Arrays over
time have the time as their first axis, ``(T, n, d)``; arrays that enter a regression have one block of rows per UAV,
``(n, R, p)``. Nothing here knows a detector.
"""
