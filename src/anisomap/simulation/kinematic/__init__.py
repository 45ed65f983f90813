"""Scenarios whose contacts follow prescribed paths."""
