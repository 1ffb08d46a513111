// The connection to the server, or to the skin in the page. It reconnects automatically, acknowledges updates so that
// the page never gets more than it can take, and matches answers to requests.

import { type Channel, openChannel } from "./channel";
import { type Alive, type Notice, VERSION } from "./protocol";

export type Link = "connecting" | "live" | "silent" | "lost";

/** Takes the messages of a page with these types of scene and state. */
export interface Listener<Scene, State> {
  link(link: Link, detail: string): void;
  scene(scene: Scene): void;
  binary(data: ArrayBuffer): void;
  state(state: State): void;
  alive(alive: Alive): void;
  notice(notice: Notice): void;
}

/** The server sends a sign of life every second; silence for this long means a lost connection. */
const SILENCE_MS = 5000;
/** Without an update for this long, the pipeline counts as silent. */
const STALE_MS = 2000;
const RETRY_MS = [250, 500, 1000, 2000, 4000];

export class Connection<Scene, State, Command> {
  private channel: Channel | null = null;
  private attempts = 0;
  private nextId = 1;
  private heard = 0;
  private updated = 0;
  /** The reason given by the server when it stopped. */
  private farewell = "";

  constructor(private readonly listener: Listener<Scene, State>) {
    this.open();
    setInterval(() => this.watch(), 500);
  }

  /** Sends a request to the pipeline. False if there is no connection. */
  ask(command: Command): boolean {
    return this.send({ v: VERSION, id: this.nextId++, command });
  }

  private send(message: object): boolean {
    if (!this.channel?.isOpen) return false;
    this.channel.send(JSON.stringify(message));
    return true;
  }

  private open(): void {
    const channel = openChannel({
      open: () => {
        this.heard = performance.now();
        this.updated = this.heard;
      },
      message: (data) => this.receive(data),
      close: (reason, isFinal) => {
        if (isFinal) this.farewell = reason;
        this.lost(channel, reason);
      },
    });
    this.channel = channel;
  }

  private lost(channel: Channel, reason: string): void {
    if (channel !== this.channel) return;
    this.channel = null;
    const wait = RETRY_MS[Math.min(this.attempts, RETRY_MS.length - 1)];
    this.attempts += 1;
    this.listener.link("lost", reason || this.farewell || "no connection; trying again");
    setTimeout(() => this.open(), wait);
  }

  private watch(): void {
    const channel = this.channel;
    if (!channel?.isOpen) return;
    const now = performance.now();
    if (now - this.heard > SILENCE_MS) {
      channel.close();
      this.lost(channel, "the server fell silent; trying again");
    } else if (now - this.updated > STALE_MS) {
      this.listener.link("silent", `no frame for ${((now - this.updated) / 1000).toFixed(0)} s`);
    }
  }

  private receive(data: string | ArrayBuffer): void {
    this.heard = performance.now();
    if (typeof data !== "string") {
      this.listener.binary(data);
      return;
    }
    const message = JSON.parse(data);
    if (message.v !== VERSION) {
      this.listener.notice({ level: "error", text: `the server speaks version ${message.v}, this page ${VERSION}: reload the page` });
      return;
    }
    switch (message.type) {
      case "scene":
      case "body_scene":
        this.attempts = 0;
        this.farewell = "";
        this.listener.scene(message);
        this.listener.link("live", "live");
        break;
      case "state":
      case "body_state":
        this.updated = this.heard;
        this.send({ v: VERSION, ack: message.sequence });
        this.listener.link("live", "live");
        this.listener.state(message);
        break;
      case "alive":
        this.listener.alive(message);
        break;
      case "notice":
        this.listener.notice(message);
        break;
      case "answer":
        this.listener.notice({ level: message.ok ? "info" : "warning", text: message.text });
        break;
    }
  }
}
