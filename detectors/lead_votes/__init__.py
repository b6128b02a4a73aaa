"""Clusters by votes for leads, neural Granger causality in each, and a gate over the whole swarm."""

from detectors.lead_votes.detector import LeadVotes

__all__ = ["LeadVotes"]
