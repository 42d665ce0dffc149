"""OPC-UA as a source: config models here, the driver and the browser in their own modules."""
