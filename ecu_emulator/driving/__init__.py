"""Driving on the road: a driver follows a speed trace, the transmission does whatever the trace asks of it."""
