"""The service: one open instrument, operated over HTTP and WebSockets by many viewers, one of them in control.

`station` owns the instrument and knows nothing of the web; `app` puts it behind the documented interface. Needs the extra ``web``.
"""
