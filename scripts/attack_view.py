#!/usr/bin/env python3
"""Attacks the live view of a training of its own, on 127.0.0.1 only, and checks that the training does not notice.

Makes a small scene, trains on it with --view, and for a while opens idle, trickling, endless, malformed and unread
connections to the page, without its token. Meanwhile it uses the page as its owner does. Stops the training from the
page while the attack goes on. Fails unless
  - the owner's requests are answered within a second,
  - the program takes at most 64 MB more memory and 80 more files than before,
  - training keeps at least --min_speed of its iterations per second,
  - the program ends in time and as it should.
Needs the built program and python3, nothing else.

  scripts/attack_view.py PROGRAM [--seconds 60] [--min_speed 0.7] [--device cpu]
"""
import argparse
import collections
import http.client
import json
import os
import random
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time

CONNECTIONS_PER_SECOND = 400  # limit for the attack
HELD = 300  # idle and trickling connections


class Attack:
    """Threads that misbehave until the time is over."""

    def __init__(self, port, seconds):
        self.port, self.end = port, time.monotonic() + seconds
        self.lock = threading.Lock()
        self.counts = collections.Counter()
        self.last = time.monotonic()

    def is_on(self):
        return time.monotonic() < self.end

    def connect(self, kind):
        """A connection, not more often than agreed; nothing if there is none to be had."""
        with self.lock:
            self.last = max(self.last + 1 / CONNECTIONS_PER_SECOND, time.monotonic())
            pause = self.last - time.monotonic()
        time.sleep(max(0, pause))
        client = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        client.settimeout(5)
        try:
            client.connect(("127.0.0.1", self.port))
        except OSError as error:
            client.close()
            if isinstance(error, ConnectionRefusedError):
                self.end = 0  # the program has ended
            return None
        with self.lock:
            self.counts[kind] += 1
        return client

    def hold(self, kind, n, begin, trickles):
        """Keeps n connections open; sends a byte on each now and then, or nothing."""
        clients = []
        while self.is_on():
            kept = []
            for client in clients:
                try:
                    client.setblocking(False)
                    try:
                        if client.recv(65536) == b"":
                            raise ConnectionResetError
                    except BlockingIOError:
                        pass
                    if trickles:
                        client.send(b"a")
                    kept.append(client)
                except OSError:
                    client.close()
            clients = kept
            while len(clients) < n and self.is_on():
                client = self.connect(kind)
                if client is None:
                    break
                try:
                    client.send(begin)
                    clients.append(client)
                except OSError:
                    client.close()
            time.sleep(0.2)

    def flood(self, kind, begin, piece):
        """Sends without end, until cut; 64 MB a connection at most."""
        while self.is_on():
            client = self.connect(kind)
            if client is None:
                time.sleep(0.1)
                continue
            try:
                client.sendall(begin)
                for _ in range(max(1, (64 << 20) // len(piece))):
                    client.sendall(piece)
                    if not self.is_on():
                        break
            except OSError:
                pass
            client.close()
            time.sleep(0.05)

    def babble(self):
        """What is hardly HTTP."""
        parts = [b"GET ", b"POST ", b"/", b"/frame", b" HTTP/1.1", b"\r\n", b"\n", b"\r", b"Host: 127.0.0.1", b"\0",
                 b"Content-Length: -1", b"Content-Length: 99999999999999999999", b"Transfer-Encoding: chunked", b"%",
                 b"Range: bytes=0-" + b",0-" * 2600, b"X-Token: " + b"0" * 32, b"?token=", b"\xff" * 9, b": ",
                 b"a" * 999]
        rng = random.Random(1)
        while self.is_on():
            client = self.connect("babble")
            if client is None:
                time.sleep(0.1)
                continue
            try:
                client.sendall(b"".join(rng.choice(parts) for _ in range(rng.randrange(1, 40))))
            except OSError:
                pass
            client.close()
            time.sleep(0.01)

    def run(self):
        idle = b"GET /state HTTP/1.1\r\nHost: 127.0.0.1\r\n"
        post = b"POST /frame HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Token: 0\r\n"
        tasks = [(self.hold, "idle", HELD // 2, b"", False), (self.hold, "half", HELD // 4, idle, False),
                 (self.hold, "trickle", HELD // 4, idle + b"X: ", True),
                 (self.flood, "endless line", idle + b"X: ", b"a" * 65536),
                 (self.flood, "endless lines", idle, b"a: b\r\n" * 10000),
                 (self.flood, "endless body", post + b"Content-Length: 999999999\r\n\r\n", b"a" * 65536),
                 (self.flood, "endless chunks", post + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\na\r\n" * 10000),
                 (self.flood, "unread answers", b"", (idle + b"\r\n") * 100), (self.babble,)]
        threads = [threading.Thread(target=task[0], args=task[1:], daemon=True) for task in tasks]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        print(", ".join(f"{n} {kind}" for kind, n in sorted(self.counts.items())))


class Owner:
    """The page's owner, and what the system says of the program."""

    def __init__(self, process, port, token):
        self.process, self.port, self.token = process, port, token

    def ask(self, method, path, body=None):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            connection.request(method, path, body, {"X-Token": self.token, "X-Client": "owner"})
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    def watch(self, seconds):
        """Uses the page. Returns iterations per second, times of the answers, most memory (MB) and open files."""
        times, memory, files, states = [], 0, 0, []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            start = time.monotonic()
            status, body = self.ask("GET", "/state?since=999999999")
            times.append(time.monotonic() - start)
            if status != 200:
                raise RuntimeError(f"/state: {status} {body[:200]!r}")
            states.append((time.monotonic(), json.loads(body)["iteration"]))
            start = time.monotonic()
            status, body = self.ask("GET", f"/?token={self.token}")
            times.append(time.monotonic() - start)
            if status != 200:
                raise RuntimeError(f"the page: {status} {body[:200]!r}")
            with open(f"/proc/{self.process.pid}/status", encoding="ascii") as lines:
                memory = max(memory, int(re.search(r"VmRSS:\s*(\d+) kB", lines.read())[1]) / 1024)
            files = max(files, len(os.listdir(f"/proc/{self.process.pid}/fd")))
            time.sleep(0.25)
        speed = (states[-1][1] - states[0][1]) / (states[-1][0] - states[0][0])
        return speed, times, memory, files


def main():
    if len(sys.argv) == 4 and sys.argv[1] == "--attack":
        os.nice(19)  # the program is measured, not how many cores the attack takes from it
        Attack(int(sys.argv[2]), float(sys.argv[3])).run()
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="b3dgs")
    parser.add_argument("--seconds", type=float, default=60, help="of the attack (at most 600)")
    parser.add_argument("--min_speed", type=float, default=0.7, help="of the iterations per second before")
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()
    seconds = min(600, args.seconds)
    faults = []

    def check(holds, fault):
        if not holds:
            faults.append(fault)

    with tempfile.TemporaryDirectory(prefix="b3dgs-attack-view-") as folder:
        scene, model = os.path.join(folder, "scene"), os.path.join(folder, "model")
        subprocess.run([args.program, "synth", "orbit", scene, "--points", "2000", "--views", "12", "--width", "160",
                        "--height", "120", "--quiet"], check=True)
        env = dict(os.environ, OMP_NUM_THREADS=str(max(1, len(os.sched_getaffinity(0)) - 1)))
        process = subprocess.Popen([args.program, "train", scene, "-m", model, "--view", "0", "--device", args.device,
                                    "--iterations", "10000000", "--densify_until_iter", "0", "--max_epochs", "0"],
                                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env)
        attack = None
        try:
            match, output = None, []
            for line in process.stdout:
                output.append(line)
                match = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\w+)", line)
                if match:
                    break
            if not match:
                sys.exit("the training printed no address:\n" + "".join(output))
            reader = threading.Thread(target=lambda: output.extend(process.stdout), daemon=True)
            reader.start()
            owner = Owner(process, int(match[1]), match[2])
            owner.watch(min(10, seconds))  # the first steps take longer
            speed, times, memory, files = owner.watch(min(20, seconds))
            print(f"before: {speed:.1f} iterations/s; answers {1e3 * sorted(times)[len(times) // 2]:.1f} ms, longest "
                  f"{1e3 * max(times):.1f} ms; {memory:.0f} MB, {files} files", flush=True)
            attack = subprocess.Popen([sys.executable, os.path.abspath(__file__), "--attack", match[1],
                                       str(seconds + 20)], stdout=subprocess.PIPE, text=True)
            during, times, memory_during, files_during = owner.watch(seconds)
            print(f"during: {during:.1f} iterations/s ({during / speed:.2f} of before); answers "
                  f"{1e3 * sorted(times)[len(times) // 2]:.1f} ms, longest {1e3 * max(times):.1f} ms; "
                  f"{memory_during:.0f} MB, {files_during} files", flush=True)
            check(max(times) <= 1, f"an answer took {max(times):.2f} s (expected at most 1 s)")
            check(memory_during <= memory + 64, "memory grew by more than 64 MB")
            check(files_during <= files + 80, "more than 80 files were opened")
            check(during >= args.min_speed * speed, f"training fell below {args.min_speed} of its speed")
            start = time.monotonic()
            status, body = owner.ask("POST", "/command", '{"command": "stop"}')
            check(status == 200, f"stop: {status} {body[:200]!r}")
            process.wait(60)
            reader.join()
            print(f"ended {time.monotonic() - start:.1f} s after Stop, with exit code {process.returncode}; attacked: "
                  + ("until then and beyond" if attack.poll() is None else "NOT until then"), flush=True)
            check(attack.poll() is None, "the attack was over before the training ended")
            check(process.returncode == 130, "expected exit code 130, as after Ctrl-C")
            checkpoints = [name for _, _, names in os.walk(model) for name in names if name.endswith(".b3dgs")]
            check(bool(checkpoints), "no checkpoint was written at the end")
            if faults:
                print("".join(output[-20:]))
        except (RuntimeError, OSError, http.client.HTTPException, subprocess.TimeoutExpired) as error:
            faults.append(f"{type(error).__name__}: {error}")
        finally:
            if process.poll() is None:
                process.kill()
            if attack is not None:
                attack.wait()
                print("attack: " + attack.stdout.read().strip())
    for fault in faults:
        print(f"attack_view.py: error: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
