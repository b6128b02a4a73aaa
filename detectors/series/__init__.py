"""The lagged time-series kernel; arrays over time are ``(T, n, d)``, those of a regression ``(n, R, p)``."""
