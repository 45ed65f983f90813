// Shows the page at the end of a session when it is reloaded after the session and its server.

self.addEventListener("install", () => self.skipWaiting());
self.addEventListener("activate", (event) => event.waitUntil(self.clients.claim()));
self.addEventListener("fetch", (event) => {
  if (event.request.mode !== "navigate") return;
  event.respondWith(fetch(event.request).catch(
    async () => await caches.match("/end") || Response.error(),
  ));
});
