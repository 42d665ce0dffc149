"""asyncua's server with its defaults closed: every override of asyncua's internals is in this folder.

Proven on asyncua 2.1.0, which pyproject.toml pins exactly; each class says what asyncua does without it.
`channel`: sockets, connections and which services exist. `frames`: what their first bytes say. `places`: who gets one
when there are not enough. `session`: sessions, their limits, and what each service may do. `subscriptions`:
subscriptions and monitored items. `view`: browsing. `decoding`: messages that would make more than they hold.
`limits`: how much of each. `items`: monitored items. `publishing`: when a subscription publishes, and what.
`outstanding`: Publish requests that wait. `reading`: Read. `parts`, `filters`: what of a value is told, and when.
"""
