"""The fleet office: alarms, peers, the page and what old results become. It attaches to the backend by entry points."""
