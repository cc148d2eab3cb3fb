// Browsers start no worker for a page that is a file, and search is one: an iframe does its work there.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.body.appendChild(document.createElement("iframe"));
      this.frame.hidden = true;
      const page = this.frame.contentWindow;
      const load = source => new Promise((done, failed) => {
        const script = page.document.createElement("script");
        Object.assign(script, {src: source, onload: done, onerror: failed});
        page.document.body.append(script);
      });
      page.importScripts = (...sources) => sources.reduce((before, each) => before.then(() => load(each)), Promise.resolve());
      page.postMessage = data => this.dispatchEvent(new MessageEvent("message", {data}));
      this.ready = load(url);
    }
    postMessage(data) {
      this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", {data})));
    }
    terminate() {
      this.frame.remove();
    }
  };
}
