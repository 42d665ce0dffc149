"""Read, Write and DataChange messages of a fixed set of variables, coded by numpy instead of object by object.

asyncua keeps connection, security, session and set-up; what comes here is the plain body of a message, before it is
signed and encrypted and after it was decrypted and put together. A body is decoded in tiers, and all tell the same:

1. the layout of the last body, checked header by header for all records at once;
2. runs of records of equal layout, where a tag turned Bad or lost its timestamp;
3. asyncua's own decoder: for the one record that is no plain number (arrays, texts), or for the whole message.
"""
