"""asyncua's server with its defaults closed: every override of asyncua's internals is in this folder.

Proven on asyncua 2.1.0, which pyproject.toml pins exactly; each class says what asyncua does without it.
`channel`: sockets and connections. `frames`: what their first bytes say. `places`: who gets one when there are not
enough. `services`: which services exist, and for whom. `session`: sessions, and what each service may do. `inner`:
what all sessions share. `secured`: signed and encrypted channels. `trust`: whose certificates are good for one.
`subscriptions`: subscriptions. `items`: monitored items. `publishing`: when a subscription publishes, and what.
`outstanding`: Publish requests that wait. `reading`: Read. `parts`, `filters`: what of a value is told, and when.
`view`: browsing. `decoding`: messages that would make more than they hold. `limits`: how much of each.
"""
