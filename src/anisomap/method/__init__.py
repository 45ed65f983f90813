"""The method: from readings to positions, stage by stage; `pipeline` shows it on one page."""
