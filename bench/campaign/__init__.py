"""Campaigns: many trials over many rows, on one machine or a cluster, resumable, with one table at the end."""
