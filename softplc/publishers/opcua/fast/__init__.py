"""Reads and data changes of the tags, coded by numpy out of the snapshot's arrays instead of object by object.

asyncua keeps connections, channels, sessions, subscriptions and every other service; here are plain bodies of
messages, after they were decrypted and put together and before they are cut into chunks and encrypted. Whatever is no
plain Read or monitored item of a tag's value takes the ordinary way, with the same result.

`encoding`: tags to bytes. `requests`: which tags a Read asks for. `reads`: its answer. `sweep`: what monitored items
have to report. `queue`: what waits to be published. `items`: the items of a subscription. `seam`: which asyncua.
"""
