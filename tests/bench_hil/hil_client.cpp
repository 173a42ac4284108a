// A stack in another language, from docs/companion.md alone: straight ahead at 1 m/s while both sensors are heard.
// It shares no code with the project. Usage: hil_client (URLs from the environment), or hil_client frames (for the test).
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <string>
#include <vector>
using Bytes = std::vector<uint8_t>;

static uint32_t crc32(const Bytes& data, size_t n) {  // as zlib: reflected 0xEDB88320
  uint32_t crc = 0xFFFFFFFF;
  for (size_t k = 0; k < n; k++)
    for (int bit = (crc ^= data[k], 0); bit < 8; bit++) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320 : crc >> 1;
  return ~crc;
}
static uint16_t crc16(const uint8_t* data, size_t n, uint8_t extra) {  // as MAVLink: X.25, then the message's extra byte
  uint16_t crc = 0xFFFF;
  for (size_t k = 0; k <= n; k++) {
    uint8_t t = (k < n ? data[k] : extra) ^ (crc & 0xFF);
    t ^= t << 4;
    crc = crc >> 8 ^ t << 8 ^ t << 3 ^ t >> 4;
  }
  return crc;
}
template <class T> static void put(Bytes& out, T value) {  // little-endian, as this machine is
  const uint8_t* p = reinterpret_cast<const uint8_t*>(&value);
  out.insert(out.end(), p, p + sizeof value);
}
template <class T> static T get(const Bytes& in, size_t at) {
  T value{};
  if (at < in.size()) memcpy(&value, &in[at], std::min(sizeof value, in.size() - at));  // MAVLink 2 cuts zeros off
  return value;
}
static Bytes rig_frame(uint8_t type, uint32_t sequence, const Bytes& payload) {  // header, payload, CRC, then COBS
  Bytes raw{1, type, 0, 255}, out;
  put(raw, sequence), put(raw, uint32_t(0)), put(raw, uint32_t(0));
  raw.insert(raw.end(), payload.begin(), payload.end());
  put(raw, crc32(raw, raw.size()));
  size_t code = 0;
  out.push_back(1);
  for (size_t k = 0; k < raw.size(); k++) {
    if (raw[k]) out.push_back(raw[k]), out[code]++;
    if (!raw[k] || (out[code] == 255 && k + 1 < raw.size())) code = out.size(), out.push_back(1);
  }
  out.push_back(0);
  return out;
}
static bool rig_decode(const Bytes& in, Bytes& raw) {  // one frame without its closing zero
  raw.clear();
  for (size_t k = 0; k < in.size();) {
    size_t code = in[k++];
    if (k + code - 1 > in.size()) return false;
    raw.insert(raw.end(), in.begin() + k, in.begin() + k + code - 1);
    k += code - 1;
    if (code < 255 && k < in.size()) raw.push_back(0);
  }
  return raw.size() >= 20 && raw[0] == 1 && crc32(raw, raw.size() - 4) == get<uint32_t>(raw, raw.size() - 4);
}
static Bytes mavlink(uint32_t id, uint8_t extra, const Bytes& payload, uint8_t sequence) {  // system 1, component 191
  Bytes out{0xFD, uint8_t(payload.size()), 0, 0, sequence, 1, 191, uint8_t(id), uint8_t(id >> 8), uint8_t(id >> 16)};
  out.insert(out.end(), payload.begin(), payload.end());
  put(out, crc16(&out[1], out.size() - 1, extra));
  return out;
}
static Bytes setpoint(uint32_t ms, float vx, float vy, float vz, float yaw_rate, uint8_t sequence) {
  Bytes p;
  put(p, ms);
  for (float v : {0.f, 0.f, 0.f, vx, vy, vz, 0.f, 0.f, 0.f, 0.f, yaw_rate}) put(p, v);
  put(p, uint16_t(0b010111000111)), put(p, uint8_t(1)), put(p, uint8_t(1)), put(p, uint8_t(8));  // mask, target, frame
  return mavlink(84, 143, p, sequence);
}
static void print(const char* name, const Bytes& data) {
  printf("%s ", name);
  for (uint8_t byte : data) printf("%02x", byte);
  printf("\n");
}
static int frames() {  // what the test compares; then ECHO frames in hexadecimal from stdin, in words
  Bytes start{0}, raw, in;
  put(start, 39.0625f);
  print("hello?", rig_frame(0x81, 0, {})), print("start", rig_frame(0x83, 1, start));
  print("setpoint", setpoint(2000, 1.f, -0.25f, 0.5f, 0.1f, 7));
  for (std::string line; std::getline(std::cin, line); in.clear()) {
    for (size_t k = 0; k + 3 < line.size(); k += 2) in.push_back(std::stoi(line.substr(k, 2), nullptr, 16));
    if (!rig_decode(in, raw) || raw[1] != 2) { printf("bad\n"); continue; }
    printf("echo %d %u %u %u %g %d", raw[3], get<uint32_t>(raw, 4), get<uint32_t>(raw, 8), get<uint32_t>(raw, 12),
           get<float>(raw, 16), raw[20]);
    for (int k = 0; k < 2 * get<uint16_t>(raw, 22); k++) printf(" %d", get<int16_t>(raw, 24 + 2 * k));
    printf("\n");
  }
  return 0;
}
static volatile sig_atomic_t asked_to_stop = 0;
static int dial(const char* variable) {
  std::string url = getenv(variable);
  size_t colon = url.rfind(':');
  sockaddr_in to{};
  to.sin_family = AF_INET, to.sin_port = htons(std::stoi(url.substr(colon + 1)));
  inet_pton(AF_INET, url.substr(6, colon - 6).c_str(), &to.sin_addr);
  int fd = socket(AF_INET, SOCK_STREAM, 0), yes = 1;
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);  // else small frames wait for each other, 10 to 80 ms
  return connect(fd, reinterpret_cast<sockaddr*>(&to), sizeof to) ? exit(1), -1 : fd;
}
int main(int count, char**) {
  if (count > 1) return frames();
  signal(SIGINT, [](int) { asked_to_stop = 1; });
  auto began = std::chrono::steady_clock::now();
  auto now_us = [&] { return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now() - began).count() + 1; };
  pollfd fds[2] = {{dial("SARANGA_ECHOES"), POLLIN, 0}, {dial("SARANGA_VEHICLE"), POLLIN, 0}};
  Bytes rig, link, raw, start{0}, hello = rig_frame(0x81, 0, {});
  put(start, 39.0625f);
  bool armed = false, guided = false, airborne = false, started = false;
  int64_t next_us = 0, heard_us[2] = {-1000000, -1000000}, heartbeat_us = 0;
  uint8_t sequence = 0;
  int echoes = 0, bad = 0, sent = 0;
  auto say = [&](const Bytes& data) { sequence++; return write(fds[1].fd, data.data(), data.size()) > 0; };
  for (uint8_t buffer[65536];;) {
    if (poll(fds, 2, std::max<int>(0, (next_us - now_us()) / 1000 + 1)) < 0 && !asked_to_stop) return 1;
    for (int which = 0; which < 2; which++) {
      if (!asked_to_stop && !fds[which].revents) continue;
      ssize_t n = asked_to_stop ? 0 : read(fds[which].fd, buffer, sizeof buffer);
      if (n <= 0) return printf("echoes %d bad %d setpoints %d\n", echoes, bad, sent), 0;
      Bytes& into = which ? link : rig;
      into.insert(into.end(), buffer, buffer + n);
    }
    for (auto end = rig.begin(); (end = std::find(rig.begin(), rig.end(), 0)) != rig.end(); rig.erase(rig.begin(), end + 1)) {
      if (!rig_decode(Bytes(rig.begin(), end), raw)) { bad++; continue; }
      if (raw[1] == 1 && !started) {
        Bytes data = rig_frame(0x83, 1, start);
        started = write(fds[0].fd, data.data(), data.size()) > 0;
      } else if (raw[1] == 2 && raw[3] < 2) echoes++, heard_us[raw[3]] = now_us();
    }
    while (link.size() >= 12) {
      size_t total = 12 + link[1] + (link[2] & 1 ? 13 : 0);
      if (link[0] != 0xFD) { link.erase(link.begin()); continue; }
      if (link.size() < total) break;
      uint32_t id = link[7] | link[8] << 8 | link[9] << 16;
      uint8_t extra = id == 0 ? 50 : id == 245 ? 130 : id == 111 ? 34 : 0;
      Bytes p(link.begin() + 10, link.begin() + 10 + link[1]);
      bool good = extra && link[5] == 1 && link[6] == 1 && crc16(&link[1], 9 + p.size(), extra) == get<uint16_t>(link, 10 + p.size());
      if (good && id == 0) armed = p[6] & 128, guided = get<uint32_t>(p, 0) == 4;
      if (good && id == 245) airborne = get<uint8_t>(p, 1) == 2;
      if (good && id == 111 && get<int64_t>(p, 0) == 0) {
        Bytes answer;
        put(answer, int64_t(now_us() * 1000)), put(answer, get<int64_t>(p, 8));
        say(mavlink(111, 34, answer, sequence));
      }
      link.erase(link.begin(), link.begin() + total);
    }
    if (now_us() < next_us) continue;
    int64_t taken_us = now_us();
    next_us = std::max<int64_t>(next_us + 62500, taken_us - 62500);
    if (!started && write(fds[0].fd, hello.data(), hello.size()) <= 0) return 1;
    if (taken_us > heartbeat_us && (heartbeat_us = taken_us + 1000000))  // type 18 onboard controller, autopilot 8 none
      say(mavlink(0, 50, {0, 0, 0, 0, 18, 8, 0, 4, 3}, sequence));
    bool blind = taken_us - std::min(heard_us[0], heard_us[1]) > 256000;  // never a command from no data
    if (armed && guided && airborne) sent += say(setpoint(taken_us / 1000, blind ? 0.f : 1.f, 0.f, 0.f, 0.f, sequence));
  }
}
