// SPDX-License-Identifier: Apache-2.0
// The pork-chop plot as SVG 1.1: cells in the colour of C3, contour lines by marching squares.
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "simulator/transfer/porkchop.h"

namespace astronav::transfer {
namespace {

using Buffer = std::back_insert_iterator<fmt::memory_buffer>;

// The picture, in pixels; the plot's corner and size inside it.
constexpr double kWidth = 960.0, kHeight = 720.0, kLeft = 80.0, kTop = 60.0, kPlotWidth = 740.0, kPlotHeight = 570.0;

struct Field {
  std::size_t columns = 0, rows = 0;  // departures, times of flight
  std::vector<double> values;         // NaN where there is none
  double at(std::size_t column, std::size_t row) const { return values[column * rows + row]; }
};

template <typename Value>
Field field_of(const Porkchop& p, Value value) {
  Field f{.columns = p.departures.size(), .rows = p.flights.size(), .values = {}};
  for (const auto& leg : p.legs) f.values.push_back(leg ? value(*leg) : std::numeric_limits<double>::quiet_NaN());
  return f;
}

double x_of(const Field& f, double column) {
  return kLeft + kPlotWidth * (column + 0.5) / static_cast<double>(f.columns);
}
double y_of(const Field& f, double row) {
  return kTop + kPlotHeight * (1.0 - (row + 0.5) / static_cast<double>(f.rows));
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else
      out += c;
  }
  return out;
}

// From dark blue (cheap) by green to pale yellow (dear); t in 0 to 1.
std::string colour(double t) {
  constexpr std::array<std::array<double, 3>, 5> stops{
      {{68, 1, 84}, {59, 82, 139}, {33, 145, 140}, {94, 201, 98}, {253, 231, 37}}};
  const double at = std::clamp(t, 0.0, 1.0) * 4.0;
  const auto i = std::min<std::size_t>(static_cast<std::size_t>(at), 3);
  std::array<int, 3> rgb{};
  for (std::size_t k = 0; k < 3; ++k)
    rgb[k] =
        static_cast<int>(std::lround(stops[i][k] + (at - static_cast<double>(i)) * (stops[i + 1][k] - stops[i][k])));
  return fmt::format("#{:02x}{:02x}{:02x}", rgb[0], rgb[1], rgb[2]);
}

// Segments of the line f = level across the squares between the middles of four cells.
void contour(Buffer out, const Field& f, double level, const char* style) {
  fmt::format_to(out, "<path {} d=\"", style);
  for (std::size_t i = 0; i + 1 < f.columns; ++i) {
    for (std::size_t k = 0; k + 1 < f.rows; ++k) {
      // Corners in turn round the square.
      const std::array<std::array<std::size_t, 2>, 4> corner{{{i, k}, {i + 1, k}, {i + 1, k + 1}, {i, k + 1}}};
      std::array<double, 4> v{};
      for (std::size_t c = 0; c < 4; ++c) v[c] = f.at(corner[c][0], corner[c][1]) - level;
      if (std::any_of(v.begin(), v.end(), [](double x) { return std::isnan(x); })) continue;
      int found = 0;
      for (std::size_t c = 0; c < 4; ++c) {
        const std::size_t d = (c + 1) % 4;
        if ((v[c] < 0.0) == (v[d] < 0.0)) continue;
        const double share = v[c] / (v[c] - v[d]);
        const auto along = [&](std::size_t axis) {
          const auto a = static_cast<double>(corner[c][axis]);
          return a + share * (static_cast<double>(corner[d][axis]) - a);
        };
        fmt::format_to(out, "{}{:.1f} {:.1f}", found % 2 == 0 ? "M" : "L", x_of(f, along(0)), y_of(f, along(1)));
        ++found;
      }
    }
  }
  fmt::format_to(out, "\"/>\n");
}

struct Cell {
  std::size_t column = 0, row = 0;
};

// The level's number, where the line is first crossed on the way from one cell straight to another.
void label(Buffer out, const Field& f, Cell from, Cell to, double level, const char* text_style) {
  const auto steps = static_cast<int>(std::max(std::max(from.column, to.column) - std::min(from.column, to.column),
                                               std::max(from.row, to.row) - std::min(from.row, to.row)));
  const auto on_way = [steps](std::size_t a, std::size_t b, double step) {
    return static_cast<double>(a) + (static_cast<double>(b) - static_cast<double>(a)) * step / steps;
  };
  const auto value = [&](int step) {
    return f.at(static_cast<std::size_t>(std::lround(on_way(from.column, to.column, step))),
                static_cast<std::size_t>(std::lround(on_way(from.row, to.row, step)))) -
           level;
  };
  for (int i = 0; i < steps; ++i) {
    const double a = value(i), b = value(i + 1);
    if (std::isnan(a) || std::isnan(b) || (a < 0.0) == (b < 0.0)) continue;
    const double step = i + a / (a - b);
    fmt::format_to(out, "<text x=\"{:.1f}\" y=\"{:.1f}\" {}>{:g}</text>\n",
                   x_of(f, on_way(from.column, to.column, step)), y_of(f, on_way(from.row, to.row, step)) + 4.0,
                   text_style, level);
    return;
  }
}

void axes(Buffer out, const Porkchop& p, const Field& f) {
  fmt::format_to(out, "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"black\"/>\n", kLeft,
                 kTop, kPlotWidth, kPlotHeight);
  constexpr int kTicks = 6;
  for (int t = 0; t < kTicks; ++t) {
    const double share = static_cast<double>(t) / (kTicks - 1);
    const auto i = static_cast<std::size_t>(std::lround(share * static_cast<double>(f.columns - 1)));
    const double x = x_of(f, static_cast<double>(i)), bottom = kTop + kPlotHeight;
    fmt::format_to(out, "<path stroke=\"black\" d=\"M{:.1f} {}v6\"/><text x=\"{:.1f}\" y=\"{}\">{}</text>\n", x, bottom,
                   x, bottom + 22.0, p.departures[i].iso(TimeScale::tdb, 0, false).substr(0, 10));
    const auto k = static_cast<std::size_t>(std::lround(share * static_cast<double>(f.rows - 1)));
    const double y = y_of(f, static_cast<double>(k));
    fmt::format_to(out, "<path stroke=\"black\" d=\"M{} {:.1f}h-6\"/><text x=\"{}\" y=\"{:.1f}\">{:g}</text>\n", kLeft,
                   y, kLeft - 25.0, y + 4.0, p.flights[k].days());
  }
  fmt::format_to(out, "<text x=\"{}\" y=\"{}\">departure</text>\n", kLeft + 0.5 * kPlotWidth,
                 kTop + kPlotHeight + 48.0);
  fmt::format_to(out, "<text transform=\"translate(22 {}) rotate(-90)\">time of flight, days</text>\n",
                 kTop + 0.5 * kPlotHeight);
}

}  // namespace

std::string to_svg(const Porkchop& p, const std::string& title) {
  const Field c3 = field_of(p, [](const LambertLeg& leg) { return leg.c3_m2_s2() * 1e-6; });
  const Field arrival = field_of(p, [](const LambertLeg& leg) { return leg.v_infinity_arrival_m_s.norm() * 1e-3; });
  const LambertLeg cheapest = p.least_c3();
  const double least = cheapest.c3_m2_s2() * 1e-6;
  // Colours run over a factor of eight in C3; what is dearer stays white.
  const auto shade = [least](double value) { return std::log(value / least) / std::log(8.0); };

  fmt::memory_buffer buffer;
  const Buffer out(buffer);
  fmt::format_to(out,
                 "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" "
                 "font-size=\"13\" text-anchor=\"middle\">\n<rect width=\"{}\" height=\"{}\" fill=\"white\"/>\n",
                 kWidth, kHeight, kWidth, kHeight);
  fmt::format_to(out, "<text x=\"{}\" y=\"34\" font-size=\"18\">{}</text>\n", kLeft + 0.5 * kPlotWidth, escaped(title));
  const double cell_width = kPlotWidth / static_cast<double>(c3.columns);
  const double cell_height = kPlotHeight / static_cast<double>(c3.rows);
  fmt::format_to(out, "<g shape-rendering=\"crispEdges\">\n");
  for (std::size_t i = 0; i < c3.columns; ++i) {
    for (std::size_t k = 0; k < c3.rows; ++k) {
      const double t = shade(c3.at(i, k));
      if (!(t <= 1.0)) continue;
      fmt::format_to(out, "<rect x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" fill=\"{}\"/>\n",
                     x_of(c3, static_cast<double>(i)) - 0.5 * cell_width,
                     y_of(c3, static_cast<double>(k)) - 0.5 * cell_height, cell_width, cell_height, colour(t));
    }
  }
  fmt::format_to(out, "</g>\n");

  Cell best;
  for (std::size_t i = 0; i < c3.values.size(); ++i) {
    if (c3.values[i] == least) best = {i / c3.rows, i % c3.rows};
  }
  // Numbers of C3 to the left of the cheapest leg, those of the arrival above and below it: there the lines lie apart.
  const Cell left{0, best.row}, top{best.column, c3.rows - 1}, bottom{best.column, 0};
  for (const double factor : {1.05, 1.2, 1.5, 2.0, 3.0, 5.0, 8.0}) {
    const double level = std::round(10.0 * factor * least) / 10.0;
    contour(out, c3, level, "fill=\"none\" stroke=\"black\" stroke-width=\"1\"");
    label(out, c3, best, left, level, "stroke=\"white\" stroke-width=\"3\" paint-order=\"stroke\"");
  }
  for (const double level : {2.5, 3.0, 4.0, 5.0, 7.0, 10.0}) {
    contour(out, arrival, level, "fill=\"none\" stroke=\"crimson\" stroke-width=\"1.3\" stroke-dasharray=\"5 3\"");
    label(out, arrival, top, bottom, level,
          "fill=\"crimson\" stroke=\"white\" stroke-width=\"3\" paint-order=\"stroke\"");
  }
  const double x = x_of(c3, static_cast<double>(best.column)), y = y_of(c3, static_cast<double>(best.row));
  fmt::format_to(out, "<path stroke=\"white\" stroke-width=\"2\" d=\"M{:.1f} {:.1f}h12m-6 -6v12\"/>\n", x - 6.0, y);
  axes(out, p, c3);
  fmt::format_to(
      out,
      "<text x=\"{}\" y=\"{}\">colours and black lines: C3 at departure, km2/s2 (least {:.3f}: {}, {:g} days); "
      "red dashes: v-infinity at arrival, km/s</text>\n</svg>\n",
      kLeft + 0.5 * kPlotWidth, kHeight - 14.0, least, cheapest.departure.iso(TimeScale::tdb, 0, false).substr(0, 10),
      (cheapest.arrival - cheapest.departure).days());
  return fmt::to_string(buffer);
}

}  // namespace astronav::transfer
