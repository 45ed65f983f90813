"""Recordings of events: contacts with the sensors they touch, and the times of spikes."""
