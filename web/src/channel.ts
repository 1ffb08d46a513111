// Carries messages between the page and the skin: a WebSocket to the server or, in a self-contained page, the worker
// that runs the skin. Both look the same to the connection.

import type { EngineEnd, ToEngine } from "./engine";

/** The parts of a WebSocket that the connection needs. */
export interface Channel {
  readonly isOpen: boolean;
  send(text: string): void;
  close(): void;
}

export interface ChannelListener {
  open(): void;
  message(data: string | ArrayBuffer): void;
  /** `isFinal`: the other side closed it on purpose and gave a reason. */
  close(reason: string, isFinal: boolean): void;
}

/** Close code of a server that is stopping. */
const SERVER_STOPS = 1001;

/** The server's WebSocket, or the worker named in the page's `data-engine`. */
export function openChannel(listener: ChannelListener): Channel {
  const engine = document.documentElement.dataset.engine;
  return engine ? new WorkerChannel(engine, listener) : new SocketChannel(listener);
}

class SocketChannel implements Channel {
  private readonly socket: WebSocket;

  constructor(listener: ChannelListener) {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    // Next to the page: a patch of a body has a page below the body's.
    this.socket = new WebSocket(`${scheme}://${location.host}${location.pathname.replace(/[^/]*$/, "")}ws`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => listener.open();
    this.socket.onmessage = (event) => listener.message(event.data);
    this.socket.onclose = (event) => listener.close(event.reason, event.code === SERVER_STOPS);
  }

  get isOpen(): boolean {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(text: string): void {
    this.socket.send(text);
  }

  close(): void {
    this.socket.close();
  }
}

class WorkerChannel implements Channel {
  /** Opens with its first message; before that it is building the skin. */
  isOpen = false;
  private hasEnded = false;
  private readonly worker: Worker;
  private readonly tellHidden = () => this.post({ isHidden: document.hidden });

  constructor(path: string, listener: ChannelListener) {
    this.worker = new Worker(path);
    this.worker.onmessage = ({ data }: MessageEvent<string | ArrayBuffer | EngineEnd>) => {
      if (typeof data !== "string" && !(data instanceof ArrayBuffer)) return this.end(listener, data.reason);
      if (!this.isOpen) {
        this.isOpen = true;
        listener.open();
        this.tellHidden();
      }
      listener.message(data);
    };
    this.worker.onerror = (event) => this.end(listener, event.message || "the skin could not be loaded");
    document.addEventListener("visibilitychange", this.tellHidden);
  }

  send(text: string): void {
    this.post({ text });
  }

  close(): void {
    this.isOpen = false;
    this.hasEnded = true;
    document.removeEventListener("visibilitychange", this.tellHidden);
    this.worker.terminate();
  }

  private post(message: ToEngine): void {
    if (this.isOpen) this.worker.postMessage(message);
  }

  private end(listener: ChannelListener, reason: string): void {
    if (this.hasEnded) return;
    this.close();
    listener.close(reason, true);
  }
}
