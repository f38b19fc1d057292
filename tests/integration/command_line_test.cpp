// SPDX-License-Identifier: Apache-2.0
// Bad input to every command of the real program: exit status 2, one line on standard error that says what is wrong,
// nothing on standard output, no crash, no hang.
#include <algorithm>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>

#include "support/program.h"

namespace astronav {
namespace {

namespace fs = std::filesystem;
using testing::Outcome;
using testing::read_text;
using testing::words;
using testing::write_text;

const fs::path kHome = ASTRONAV_TEST_HOME;

struct Bad {
  const char* line;  // after "astronav"
  const char* says;  // must stand in the sentence
};

// A file that is not what it should be.
struct BadFile {
  const char* file;
  const char* says;
};

const std::vector<BadFile> kNoKernel{
    {"missing.bsp", "no such file"},       {"empty", "is not an SPK kernel: it has 0 bytes"},
    {"cut.bsp", "not inside the file"},    {"stub.bsp", "is not an SPK kernel"},
    {"frame.png", "is not an SPK kernel"}, {"mission.toml", "is not an SPK kernel"},
    {"folder", "is not a regular file"},   {"pipe", "is not a regular file"}};
const std::vector<BadFile> kNoScenario{
    {"missing.toml", "no such file"},   {"empty", "the file is empty"}, {"cut.toml", "not TOML"},
    {"frame.png", "not TOML"},          {"cut.bsp", "not TOML"},        {"camera.toml", "unknown section"},
    {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoCamera{{"missing", "no such camera"},   {"empty", "the file is empty"},
                                     {"cut-camera.toml", "TOML"},     {"frame.png", "not valid TOML"},
                                     {"mission.toml", "unknown key"}, {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoCatalogue{{"missing", "no such file"},
                                        {"empty", "but only 0 are there"},
                                        {"cut.stars", "make a file of"},
                                        {"frame.png", "not a star catalogue"},
                                        {"mission.toml", "not a star catalogue"},
                                        {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoPicture{{"missing.png", "no such file"},     {"empty", "the file is empty"},
                                      {"cut.png", "ends too early"},       {"cut.fits", "its header promises"},
                                      {"mission.toml", "not a picture"},   {"cut.bsp", "not a picture"},
                                      {"folder", "is not a regular file"}, {"pipe", "is not a regular file"}};
const std::vector<BadFile> kNoTrajectory{{"missing", "no such file"},
                                         {"empty", "the file is empty"},
                                         {"cut.oem", "is the file cut off?"},
                                         {"cut.bsp", "not inside the file"},
                                         {"frame.png", "neither an SPK kernel"},
                                         {"mission.toml", "neither an SPK kernel"},
                                         {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoOem{{"missing", "no such file"},          {"empty", "the file is empty"},
                                  {"cut.oem", "is the file cut off?"},  {"frame.png", "not printable ASCII"},
                                  {"mission.toml", "mission.toml:1:1"}, {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoPlan{{"missing", "no such file"},
                                   {"empty", "the file is empty"},
                                   {"cut.oem", "not a thrust plan"},
                                   {"frame.png", "not a thrust plan"},
                                   {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoTable{{"missing", "no such file"},
                                    {"empty", "neither a Hipparcos main table"},
                                    {"cut.gz", "cut.gz"},
                                    {"frame.png", "neither a Hipparcos main table"},
                                    {"folder", "is not a regular file"}};
const std::vector<BadFile> kNoCampaign{{"missing", "no such file"},
                                       {"empty", "not a file of a campaign"},
                                       {"cut.jsonl", "cut.jsonl"},
                                       {"frame.png", "not a file of a campaign"},
                                       {"folder", "no samples"}};

struct Hole {
  const char* line;  // @ stands for the file
  const std::vector<BadFile>* files;
};

const std::vector<Hole> kHoles{
    {"run @ --level mil --out results", &kNoScenario},
    {"run --level mil --out results --set data.ephemeris_file=@", &kNoKernel},
    {"run --level mil --out results --set data.catalogue_file=@", &kNoCatalogue},
    {"run --level mil --out results --set truth.camera.file=@", &kNoCamera},
    {"run --level mil --out results --set onboard.camera.file=@", &kNoCamera},
    {"run --level mil --out results --set mission.trajectory_file=@", &kNoOem},
    {"campaign @ --level mil --samples 1 --out results", &kNoScenario},
    {"campaign earth-mars-ballistic --samples 1 --out results --set data.ephemeris_file=@", &kNoKernel},
    {"campaign earth-mars-ballistic --samples 1 --out results --set onboard.camera.file=@", &kNoCamera},
    {"campaign merge @", &kNoCampaign},
    {"campaign slurm @", &kNoScenario},
    {"beacons @", &kNoScenario},
    {"beacons --set data.ephemeris_file=@", &kNoKernel},
    {"beacons --set mission.trajectory_file=@", &kNoOem},
    {"ephemeris mars --epoch 2026-11-22 --kernel @", &kNoKernel},
    {"render --epoch 2026-11-22 --pointing 83,-1,0 --out x.fits --kernel @", &kNoKernel},
    {"render --epoch 2026-11-22 --pointing 83,-1,0 --out x.fits --camera @", &kNoCamera},
    {"render --epoch 2026-11-22 --pointing 83,-1,0 --out x.fits --catalog @", &kNoCatalogue},
    {"render --epoch 2026-11-22 --pointing 83,-1,0 --out x.fits --observer oem:@", &kNoOem},
    {"render --epoch 2026-11-22 --pointing 83,-1,0 --out x.fits --observer spk:-96@@", &kNoKernel},
    {"solve @", &kNoPicture},
    {"solve frame.fits --camera @", &kNoCamera},
    {"solve frame.fits --catalog @", &kNoCatalogue},
    {"solve frame.fits --epoch 2026-11-22 --observer earth --kernel @", &kNoKernel},
    {"solve frame.fits --epoch 2026-11-22 --observer oem:@", &kNoOem},
    {"compare @", &kNoPicture},
    {"compare frame.fits --camera @", &kNoCamera},
    {"compare frame.fits --catalog @", &kNoCatalogue},
    {"calibrate camera @", &kNoPicture},
    {"calibrate camera frame.fits --camera @", &kNoCamera},
    {"calibrate camera frame.fits --catalog @", &kNoCatalogue},
    {"calibrate camera frame.fits --epoch 2026-11-22 --observer earth --kernel @", &kNoKernel},
    {"centroids @", &kNoPicture},
    {"centroids frame.fits --camera @", &kNoCamera},
    {"catalog info --catalog @", &kNoCatalogue},
    {"catalog cone 83,-1,3 --catalog @", &kNoCatalogue},
    {"catalog import @ --out new.stars", &kNoTable},
    {"trajectory info @", &kNoTrajectory},
    {"serve --port 0 --camera @", &kNoCamera},
    {"serve --port 0 --kernel @", &kNoKernel},
    {"serve --port 0 --catalog @", &kNoCatalogue},
    {"serve --port 0 --observer craft=oem:@", &kNoOem},
    {"trajectory convert @ new.oem", &kNoTrajectory},
    {"trajectory convert cruise.oem new.oem --step 1h --kernel @", &kNoKernel},
    {"trajectory design --departure 2026-11-09 --days 300 --kernel @", &kNoKernel},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --kernel @", &kNoKernel},
    {"trajectory porkchop --departure 2026-08-15 --kernel @", &kNoKernel},
    {"trajectory arrival @", &kNoOem},
    {"trajectory arrival cruise.oem --kernel @", &kNoKernel},
    {"trajectory fly @", &kNoOem},
    {"trajectory fly cruise.oem --plan @", &kNoPlan},
    {"trajectory fly cruise.oem --kernel @", &kNoKernel},
};

const std::vector<Bad> kBad{
    {"", "A subcommand is required"},
    {"ephemris", "did you mean 'astronav ephemeris'?"},
    {"catalog kone", "did you mean 'astronav catalog cone'?"},
    {"trajectory desing", "did you mean 'astronav trajectory design'?"},
    {"catalog", "A subcommand is required"},
    {"trajectory", "A subcommand is required"},
    {"serve --frobnicate", "--frobnicate"},
    {"serve --port 65536", "--port: '65536' is not a number from 0 to 65535"},
    {"serve --web-port 65536", "65536"},
    {"serve --port 0 --listen example.com", "is no address of this machine"},
    {"serve --port 0 --listen 0.0.0.0", "that demands a token"},
    {"serve --port 0 --token-file missing", "no such file"},
    {"serve --port 0 --token-file empty", "holds no token"},
    {"serve --port 0 --observer craft", "names no observer"},
    {"serve --port 0 --observer mars=earth", "no body's name"},
    {"serve --port 0 --workers -1", "-1"},
    {"serve --port 0 --sessions 0", "0"},
    {"fix", "either pictures or --sight"},
    {"fix --frobnicate", "--frobnicate"},
    {"fix frame.fits", "pictures need a list of near stars"},
    {"fix frame.fits --targets missing.csv", "no such file"},
    {"fix frame.fits --targets mission.toml", "no list of stars"},
    {"fix --sight mars,1,2,3", "sights are of an --epoch"},
    {"fix --epoch 2026-11-22 --sight marz,1,2,3", "mars"},
    {"fix --epoch 2026-11-22 --sight mars,1,2", "RA,DEC,SIGMA_ARCSEC"},
    {"fix --epoch 2026-11-22 --sight mars,1,2,0", "no such sight"},
    {"fix --epoch 2026-11-22 --sight mars,1,2,3", "a place needs two"},
    {"fix --epoch 2026-11-22 --sight mars,1,2,3 --sight venus,50,2,3 --velocity 1,2", "--velocity"},
    {"bench --frobnicate", "--frobnicate"},
    {"bench --only speed", "there is no such figure"},

    {"run --frobnicate", "--frobnicate"},
    {"run a b", "not expected: b"},
    {"run ''", "no such file"},
    {"run --seed -1", "--seed: '-1' is not a seed"},
    {"run --seed nan", "'nan' is not a seed"},
    {"run --seed 99999999999999999999", "is not a seed"},
    {"run --level xil", "\"xil\" is not a level"},
    {"run --level hil", "level hil is not there yet"},
    {"run --schema=poem", "\"poem\" is not a form"},
    {"run --set conops.cycle_dais=5", "did you mean \"conops.cycle_days\"?"},
    {"run --set conops.cycle_days", "expected key=value"},
    {"run --set conops.cycle_days=nan", "nan is outside 0.1 to 100"},
    {"run --set conops.cycle_days=-3", "-3 is outside 0.1 to 100"},
    {"run --set conops.cycle_days=inf", "inf is outside"},
    {"run --set conops.cycle_days=soon", "is not a TOML value"},
    {"run --set conops.cycle_days=[1]", "must be a number"},
    {"run --set 'conops.cycle_days={gaussian={mean=5,sigma=-1}}'", "sigma must not be negative"},
    {"run --set 'conops.cycle_days={gaussian={mean=nan,sigma=1}}'", "nan is outside"},
    {"run --set onboard.vision.centroid_method=guess", "must be one of"},
    {"run --set mission.departure=nan", "'nan' is not an epoch"},
    {"run --set mission.departure=", "an epoch is missing"},
    {"run --set mission.departure=1700-01-01", "the year must lie in"},
    {"run --level mil --out results --set mission.departure=2199-01-01", "the kernels do not reach"},
    {"run --level mil --out results --set mission.to=vulcan", "there is no body 'vulcan'"},
    {"run --level mil --out results --set mission.to=earth", "from one planet to another"},
    {"run --level mil --out results --set mission.to=sun", "from one planet to another"},
    {"run --level mil --out results --set mission.days=2", "no cruise left"},
    {"run --level mil --out results --set 'onboard.filter.bodies=[\"vulcan\"]'", "there is no body 'vulcan'"},
    {"run --level mil --out results --set 'truth.dynamics.bodies=[\"vulcan\"]'", "there is no body 'vulcan'"},
    {"run --level mil --out frame.png", "cannot make the folder"},

    {"campaign", "which scenario?"},
    {"campaign earth-mars-ballistic --samples 0", "--samples: '0' is not a number from 1 to"},
    {"campaign earth-mars-ballistic --samples nan", "'nan' is not a number"},
    {"campaign earth-mars-ballistic --samples 1.5", "1.5"},
    {"campaign earth-mars-ballistic --jobs -2", "--jobs: '-2' is not a number"},
    {"campaign earth-mars-ballistic --seed -2", "'-2' is not a seed"},
    {"campaign earth-mars-ballistic --shard 0/0", "\"0/0\" is not a shard"},
    {"campaign earth-mars-ballistic --shard 5/2", "\"5/2\" is not a shard"},
    {"campaign earth-mars-ballistic --level xil", "\"xil\" is not a level"},
    {"campaign earth-mars-ballistic --set x=y", "unknown key \"x\""},
    {"campaign earth-mars-ballistic --set mission.to=vulcan --out results", "there is no body 'vulcan'"},
    {"campaign earth-mars-ballistic --out frame.png", "cannot make the folder"},
    {"campaign merge", "folders is required"},
    {"campaign slurm", "scenario is required"},
    {"campaign slurm earth-mars-ballistic --shards 0", "--shards: '0' is not a number"},
    {"campaign slurm earth-mars-ballistic --samples -4", "--samples: '-4' is not a number"},
    {"campaign slurm earth-mars-ballistic --level xil", "\"xil\" is not a level"},

    {"beacons --seed nan", "'nan' is not a seed"},
    {"beacons --set x=1", "unknown key \"x\""},
    {"beacons --set conops.sun_exclusion_deg=nan", "nan is outside"},
    {"beacons --set mission.departure=2199-01-01", "the kernels do not reach"},
    {"beacons --set mission.days=2", "no cruise left"},

    {"ephemeris", "body is required"},
    {"ephemeris mars", "--epoch is required"},
    {"ephemeris marz --epoch 2026-01-01", "'marz' (the nearest name is 'mars'"},
    {"ephemeris '' --epoch 2026-01-01", "a body is missing"},
    {"ephemeris 12345 --epoch 2026-01-01", "no kernel holds body 12345"},
    {"ephemeris earth --epoch 2026-01-01", "cannot be seen from itself"},
    {"ephemeris mars --from marz --epoch 2026-01-01", "--from: there is no body 'marz'"},
    {"ephemeris mars --epoch ''", "an epoch is missing"},
    {"ephemeris mars --epoch nan", "'nan' is not an epoch"},
    {"ephemeris mars --epoch 2026-02-30", "that month has no day 30"},
    {"ephemeris mars --epoch '2026-01-01 XYZ'", "none of UTC, TAI, TT, TDB"},
    {"ephemeris mars --epoch '1999-01-01 TDB'", "the kernels do not reach"},
    {"ephemeris mars --epoch 2199-01-01 --json", "the kernels do not reach"},
    {"ephemeris mars --epoch 2050-12-01/2051-12-01/10d --json", "the kernels do not reach"},
    {"ephemeris mars --epoch 2026-01-01/2025-01-01/1d", "ends before it begins"},
    {"ephemeris mars --epoch 2026-01-01/2027-01-01", "expected START/STOP/STEP"},
    {"ephemeris mars --epoch 2026-01-01/2027-01-01/0d", "the step must be longer"},
    {"ephemeris mars --epoch 2026-01-01/2027-01-01/-1d", "the step must be longer"},
    {"ephemeris mars --epoch 2026-01-01/2027-01-01/1parsec", "the unit must be one of"},
    {"ephemeris mars --epoch 2026-01-01/2027-01-01/1ms", "at most 1000000"},
    {"ephemeris mars --epoch 2026-01-01 --correction guess", "guess not in {none,lt,lt+s}"},
    {"ephemeris mars --epoch 2026-01-01 --iterations 0", "--iterations: '0' is not a number from 1 to 10"},
    {"ephemeris mars --epoch 2026-01-01 --iterations nan", "'nan' is not a number"},

    {"ephemeris mars --law 3 --epoch 2026-01-01", "is not H,G or H,G1,G2"},
    {"ephemeris ceres --epoch 2026-11-22", "no kernel holds ceres"},
    {"render", "--epoch is required"},
    {"render --epoch soon --pointing 1,2,3 --out x.fits", "'soon' is not an epoch"},
    {"render --epoch 2199-01-01 --pointing 1,2,3 --out x.fits", "the kernels do not reach"},
    {"render --epoch 2026-11-22 --pointing 1,2 --out x.fits", "'1,2' is not RA,DEC,ROLL"},
    {"render --epoch 2026-11-22 --pointing nan,0,0 --out x.fits", "'nan,0,0' is not RA,DEC,ROLL"},
    {"render --epoch 2026-11-22 --pointing 0,91,0 --out x.fits", "'0,91,0' is not a pointing"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.jpg", "'x.jpg' does not end in .fits or .fit or .png"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out nowhere/x.fits", "cannot be written"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out nowhere/x.png", "cannot be written"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --truth nowhere/t.json", "cannot be written"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --truth x.fits", "--truth: 'x.fits' is named twice"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --truth folder/../x.fits", "is named twice"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out folder/x.fits --truth folder", "cannot be written"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --rate 0,100,0", "--rate: the camera turns by"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --refraction",
     "--refraction: there is no air at 'earth'"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --body 2000433", "--body: '' is not H,G[,RADIUS_KM]"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --body 2000433,1", "'1' is not H,G[,RADIUS_KM]"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --body 2000433,1,1,-1", "-1 km is not within"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --body vulcan,1,1", "there is no body 'vulcan'"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --body mars,1,1", "body 499 is drawn as it is"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --body 2000433,1,1", "--body: no kernel holds"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --exposure-ms nan",
     "--exposure-ms: 'nan' is not a number"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --exposure-ms -1", "'-1' is not a number"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --max-v nan", "--max-v: 'nan' is not a number"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --rate 1,2", "'1,2' is not X,Y,Z in degrees a second"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --rate 1,nan,2", "is not X,Y,Z in degrees a second"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --without rain",
     "no effect is called 'rain'; did you mean 'dark'"},
    {"render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --seed -1", "'-1' is not a seed"},

    {"compare", "image is required"},
    {"compare frame.fits --out x.jpg", "'x.jpg' does not end in .png"},
    {"compare frame.fits --out nowhere/x.png", "nowhere/x.png: "},
    {"compare frame.fits --save-camera nowhere/x.toml", "nowhere/x.toml: "},
    {"compare frame.png --out frame.png", "'frame.png' is named twice"},
    {"compare frame.fits --targets camera.toml", "camera.toml: no list of stars"},
    {"compare frame.fits --targets camera.toml", "no column 'epoch_jyear'"},
    {"compare frame.fits --fov nan", "'nan' is not MIN:MAX"},
    {"compare frame.fits --snr 1", "'1' is not a number from 3 to 10000"},
    {"compare frame.fits --observer marz", "'marz' is not an observer"},
    {"solve", "images is required"},
    {"solve frame.fits --fov nan", "'nan' is not MIN:MAX"},
    {"solve frame.fits --fov 3:2", "'3:2' is no field of view"},
    {"solve frame.fits --fov -3", "'-3' is no field of view"},
    {"solve frame.fits --fov 10:500", "'10:500' is no field of view"},
    {"solve frame.fits --near nan,1,2", "'nan,1,2' is not RA,DEC,RADIUS"},
    {"solve frame.fits --near 0,99,3", "a declination within 90 degrees"},
    {"solve frame.fits --epoch soon", "'soon' is not an epoch"},
    {"solve frame.fits --observer earth", "only at an --epoch"},
    {"solve frame.fits --camera lorri", "the picture has"},
    {"solve frame.fits --epoch 2199-01-01 --observer earth", "the kernels do not reach"},
    {"solve frame.fits --epoch 2026-11-22 --observer marz", "'marz' is not an observer"},
    {"solve frame.fits --picture x.jpg", "--picture: 'x.jpg' does not end in .png"},
    {"solve frame.fits --wcs x.png", "--wcs: 'x.png' does not end in .fits or .fit"},
    {"solve frame.fits --raw 10x10,u32,0", "is not a raw layout"},
    {"solve frame.fits --raw 99999x99999,u16le,0", "at most 200000000 in all"},

    {"solve frame.fits --wcs frame.fits", "one would overwrite the other"},
    {"solve frame.fits --kernel none.bsp", "none is given"},
    {"centroids frame.fits --method squares", "--method requires --camera"},
    {"calibrate", "A subcommand is required"},
    {"calibrate kamera", "did you mean 'astronav calibrate camera'?"},
    {"calibrate camera", "images is required"},
    {"calibrate camera frame.fits ./frame.fits", "would count its stars twice"},
    {"calibrate camera frame.fits --fov nan", "'nan' is not MIN:MAX"},
    {"calibrate camera frame.fits --fov 3:200", "'3:200' is no field of view"},
    {"calibrate camera frame.fits --fisheye --fov 3:400", "0 < MIN <= MAX < 360"},
    {"calibrate camera frame.fits --near 0,99,3", "a declination within 90 degrees"},
    {"calibrate camera frame.fits --epoch soon", "'soon' is not an epoch"},
    {"calibrate camera frame.fits --epoch 2026-11-22 --epoch 2026-11-23", "one epoch for all 1 images"},
    {"calibrate camera frame.fits --epoch 2026-11-22,2026-11-23", "one epoch for all 1 images"},
    {"calibrate camera frame.fits 2026-11-22 --fov 19:21", "an epoch where a picture is expected"},
    {"calibrate camera frame.fits --kernel none.bsp", "none is given"},
    {"calibrate camera frame.fits --out camera.png", "'camera.png' does not end in .toml"},
    {"calibrate camera frame.fits --observer earth", "only at an --epoch"},
    {"calibrate camera frame.fits --epoch 2199-01-01 --observer earth", "the kernels do not reach"},
    {"calibrate camera frame.fits --epoch 2026-11-22 --observer ground:91,0,0", "the latitude 91"},
    {"calibrate camera frame.fits --raw 10x10,u32,0", "is not a raw layout"},
    {"calibrate camera frame.fits --camera all-sky-fisheye --fov 0:10", "is no field of view"},
    {"calibrate camera frame.fits --fov 19:21 --out nowhere/camera.toml", "cannot be written"},

    {"centroids", "image is required"},
    {"centroids frame.fits --sigma -1", "-1"},
    {"centroids frame.fits --method guess", "guess not in"},
    {"centroids frame.fits --raw 0x0,u16le,0", "is not a raw layout"},
    {"centroids frame.fits --raw 4096x4096,u16le,0", "frame.fits"},

    {"catalog info --frobnicate", "--frobnicate"},
    {"catalog cone", "cone is required"},
    {"catalog cone 1,2", "'1,2' is not RA,DEC,RADIUS"},
    {"catalog cone nan,1,1", "'nan,1,1' is not RA,DEC,RADIUS"},
    {"catalog cone 1,99,1", "declination lies between"},
    {"catalog cone 1,2,-3", "the radius between"},
    {"catalog cone 1,2,3 --max-v nan", "--max-v: 'nan' is not a number"},
    {"catalog import cruise.oem", "--out is required"},
    {"catalog import", "tables is required"},

    {"trajectory info", "file is required"},
    {"trajectory convert cruise.oem", "out is required"},
    {"trajectory convert cruise.oem new.bsp", "SPK kernels are not written"},
    {"trajectory convert cruise.oem nowhere/new.oem", "cannot be written"},
    {"trajectory convert cruise.oem new.oem --body mars", "--body is for SPK kernels"},
    {"trajectory convert cruise.oem new.oem --center marz", "there is no body 'marz'"},
    {"trajectory convert cruise.oem new.oem --center 77", "no kernel holds body 77"},
    {"trajectory convert cruise.oem new.oem --begin nan", "--begin: 'nan' is not an epoch"},
    {"trajectory convert cruise.oem new.oem --begin 1990-01-01", "does not cover 1990-01-01"},
    {"trajectory convert cruise.oem new.oem --begin 2199-01-01", "before the begin"},
    {"trajectory convert cruise.oem new.oem --step 0s", "in steps of 0 s"},
    {"trajectory convert cruise.oem new.oem --step -1d", "in steps of -86400 s"},
    {"trajectory convert cruise.oem new.oem --step nan", "'nan' is not a duration"},
    {"trajectory convert home/data/de405_2000_2050.bsp new.oem", "choose one with --body"},
    {"trajectory convert home/data/de405_2000_2050.bsp new.oem --body marz", "there is no body 'marz'"},
    {"trajectory convert home/data/de405_2000_2050.bsp new.oem --body 77", "no kernel holds body 77"},
    {"trajectory design", "--departure is required"},
    {"trajectory design --departure nan --days 300", "'nan' is not an epoch"},
    {"trajectory design --departure 2199-01-01 --days 300", "the kernels do not reach"},
    {"trajectory design --departure 2026-11-09 --days nan", "--days: 'nan' is not a number"},
    {"trajectory design --departure 2026-11-09 --days -5", "--days: '-5' is not a number"},
    {"trajectory design --departure 2026-11-09 --days 2", "no cruise left"},
    {"trajectory design --departure 2026-11-09 --days 300 --to vulcan", "there is no body 'vulcan'"},
    {"trajectory design --departure 2026-11-09 --days 300 --to earth", "from one planet to another"},
    {"trajectory design --departure 2026-11-09 --days 300 --miss-km nan", "--miss-km: 'nan' is not a number"},
    {"trajectory design --departure 2026-11-09 --days 300 --miss-km 1", "beyond the body's radius"},
    {"trajectory design --departure 2026-11-09 --days 300 --coast-in-days nan", "'nan' is not a number"},
    {"trajectory design --departure 2026-11-09 --days 300 --out new.oem --step nan", "'nan' is not a duration"},
    {"trajectory design --departure 2026-11-09 --days 300 --out new.bsp", "SPK kernels are not written"},
    {"trajectory design --departure 2026-11-09 --days 300 --out nowhere/new.oem", "cannot be written"},
    {"trajectory low-thrust --days 300", "--departure is required"},
    {"trajectory low-thrust --departure nan --days 300", "--departure: 'nan' is not an epoch"},
    {"trajectory low-thrust --departure 2199-01-01 --days 300", "the kernels do not reach"},
    {"trajectory low-thrust --departure 2026-11-09 --days nan", "--days: 'nan' is not a number"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --to marz", "there is no body 'marz'"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --to earth", "from one planet to another"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --thrust-mn 0", "--thrust-mn: '0' is not a number"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --mass-kg -1", "--mass-kg: '-1' is not a number"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --step nan", "'nan' is not a duration"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --out nowhere/new.oem", "cannot be written"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --plan nowhere/new.csv", "cannot be written"},
    {"trajectory low-thrust --departure 2026-11-09 --days 300 --out same --plan same", "--plan"},
    {"trajectory fly", "cruise is required"},
    {"trajectory fly cruise.oem --days nan", "--days: 'nan' is not a number"},
    {"trajectory fly cruise.oem --days 90000", "the kernels do not reach"},
    {"trajectory fly cruise.oem --acceleration -1", "--acceleration: '-1' is not a number"},
    {"trajectory fly cruise.oem --thrust-percent nan", "--thrust-percent: 'nan' is not a number"},
    {"trajectory fly cruise.oem --thrust-deg nan", "--thrust-deg: 'nan' is not a number"},
    {"trajectory fly cruise.oem --seed -1", "--seed"},
    {"trajectory fly cruise.oem --step nan", "'nan' is not a duration"},
    {"trajectory fly cruise.oem --out nowhere/new.oem", "cannot be written"},
    {"trajectory arrival", "file is required"},
    {"trajectory arrival cruise.oem", "holds no covariance"},
    {"trajectory arrival cruise.oem --body marz", "there is no body 'marz'"},
    {"trajectory arrival cruise.oem --days nan", "--days: 'nan' is not a number"},
    {"trajectory arrival cruise.oem --cr-area-mass nan", "'nan' is not a number"},
    {"trajectory porkchop", "--departure is required"},
    {"trajectory porkchop --departure nan", "--departure: 'nan' is not an epoch"},
    {"trajectory porkchop --departure 2199-01-01", "the kernels do not reach"},
    {"trajectory porkchop --departure 2026-08-15 --from marz", "there is no body 'marz'"},
    {"trajectory porkchop --departure 2026-08-15 --flight-days 300 200", "is shorter than the shortest"},
    {"trajectory porkchop --departure 2026-08-15 --step-days 0", "--step-days: '0' is not a number"},
    {"trajectory porkchop --departure 2026-08-15 --window-days 90000 --step-days 0.01", "are more than"},
    {"trajectory porkchop --departure 2026-08-15 --csv nowhere/x.csv", "cannot be written"},
    {"trajectory porkchop --departure 2026-08-15 --svg nowhere/x.svg", "cannot be written"},
};

// Observers of parse_observer, by the way of render.
const std::vector<BadFile> kNoObserver{
    {"''", "'' is not an observer"},
    {"marz", "'marz' is not an observer"},
    {"77", "no kernel holds body 77"},
    {"ssb:", "'' is not ssb:X,Y,Z"},
    {"ssb:1,2", "'1,2' is not ssb:X,Y,Z"},
    {"ssb:1,2,3,4", "has 4 numbers"},
    {"ssb:nan,0,0", "'nan,0,0' is not ssb:X,Y,Z"},
    {"ssb:1e30,0,0", "is farther than"},
    {"ssb:0,0,0,300000,0,0", "is not slower than light"},
    {"ground:", "'' is not ground:LAT,LON,HEIGHT_M"},
    {"ground:91,0,0", "the latitude 91"},
    {"ground:0,400,0", "the longitude 400"},
    {"ground:0,0,1e9", "the height"},
    {"ground:a,b,c", "'a,b,c' is not ground:LAT,LON,HEIGHT_M"},
    {"spk:", "expected spk:ID@FILE"},
    {"spk:-96", "expected spk:ID@FILE"},
    {"spk:-96@", "expected spk:ID@FILE"},
    {"spk:@x", "a body is missing"},
    {"spk:-96@home/data/de405_2000_2050.bsp", "no kernel holds"},
    {"oem:", "expected oem:FILE"},
};

std::string half(const fs::path& path) {
  const std::string text = read_text(path);
  return text.substr(0, text.size() / 2);
}

class CommandLine : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    scratch_ = std::make_unique<testing::ScratchFolder>();
    const fs::path& at = folder();
    fs::create_directory(at / "folder");
    fs::create_directory_symlink(kHome, at / "home");
    ASSERT_EQ(mkfifo((at / "pipe").c_str(), 0600), 0);
    write_text(at / "empty", "");
    ASSERT_EQ(astronav("render --epoch 2026-11-22 --pointing 83.8,-1.2,0 --out frame.fits").status, 0);
    ASSERT_EQ(astronav("render --epoch 2026-11-22 --pointing 83.8,-1.2,0 --out frame.png").status, 0);
    ASSERT_EQ(astronav("trajectory design --departure 2026-11-09 --days 300 --out cruise.oem").status, 0);
    for (const char* name : {"fits", "png"})
      write_text(at / (std::string("cut.") + name), half(at / (std::string("frame.") + name)));
    write_text(at / "cut.oem", half(at / "cruise.oem"));
    write_text(at / "cut.bsp", half(kHome / "data/de405_2000_2050.bsp"));
    write_text(at / "stub.bsp", read_text(at / "cut.bsp").substr(0, 100));
    write_text(at / "cut.stars", half(kHome / "data/hipparcos.stars"));
    write_text(at / "mission.toml", read_text(kHome / "scenarios/earth-mars-ballistic.toml"));
    write_text(at / "cut.toml", "[mission]\nname = \"cut\"\ndays =");
    write_text(at / "camera.toml", read_text(kHome / "scenarios/cameras/extrema-20deg.toml"));
    write_text(at / "cut-camera.toml", "name = \"cut\"\n[image]\nwidth_px =");
    write_text(at / "cut.gz", "\x1f\x8b\x08");
    write_text(at / "cut.jsonl", "{\"astronav campaign\":");
  }
  static void TearDownTestSuite() { scratch_.reset(); }

  static const fs::path& folder() { return scratch_->path(); }
  static Outcome astronav(const std::string& line) {
    return testing::run_program(ASTRONAV_PROGRAM, words(line), folder());
  }

  // Exit status 2, one line that names the trouble, nothing else.
  static void expect_refused(const std::string& line, const std::vector<std::string>& says) {
    const Outcome got = astronav(line);
    const std::string all = "astronav " + line + "\nstatus " + std::to_string(got.status) +
                            "\nerr: " + got.err.substr(0, 500) + "\nout: " + got.out.substr(0, 200);
    EXPECT_EQ(got.status, 2) << all;
    EXPECT_EQ(got.out, "") << all;
    EXPECT_EQ(got.err.rfind("astronav: ", 0), 0u) << all;
    EXPECT_EQ(std::count(got.err.begin(), got.err.end(), '\n'), 1) << all;
    EXPECT_EQ(got.err.empty() ? '\0' : got.err.back(), '\n') << all;
    for (const std::string& part : says)
      EXPECT_NE(got.err.find(part), std::string::npos) << "wanted: " << part << "\n" << all;
  }

  // Holes whose command begins with `command`.
  static void expect_files_refused(std::string_view command) {
    int tried = 0;
    for (const Hole& hole : kHoles) {
      if (!std::string_view(hole.line).starts_with(command)) continue;
      for (const BadFile& bad : *hole.files) {
        std::string line = hole.line;
        line.replace(line.rfind('@'), 1, bad.file);
        expect_refused(line, {bad.file, bad.says});
        ++tried;
      }
    }
    EXPECT_GT(tried, 0) << command;
  }

 private:
  static std::unique_ptr<testing::ScratchFolder> scratch_;
};
std::unique_ptr<testing::ScratchFolder> CommandLine::scratch_;

TEST_F(CommandLine, RunRefusesBadFiles) {
  expect_files_refused("run");
}
TEST_F(CommandLine, CampaignRefusesBadFiles) {
  expect_files_refused("campaign");
}
TEST_F(CommandLine, BeaconsRefusesBadFiles) {
  expect_files_refused("beacons");
}
TEST_F(CommandLine, EphemerisRefusesBadFiles) {
  expect_files_refused("ephemeris");
}
TEST_F(CommandLine, RenderRefusesBadFiles) {
  expect_files_refused("render");
}
TEST_F(CommandLine, CalibrateRefusesBadFiles) {
  expect_files_refused("calibrate");
}
TEST_F(CommandLine, SolveRefusesBadFiles) {
  expect_files_refused("solve");
}
TEST_F(CommandLine, CompareRefusesBadFiles) {
  expect_files_refused("compare");
}
TEST_F(CommandLine, CentroidsRefusesBadFiles) {
  expect_files_refused("centroids");
}
TEST_F(CommandLine, CatalogRefusesBadFiles) {
  expect_files_refused("catalog");
}
TEST_F(CommandLine, TrajectoryRefusesBadFiles) {
  expect_files_refused("trajectory");
}

TEST_F(CommandLine, SenselessArgumentsAreRefused) {
  for (const Bad& bad : kBad) expect_refused(bad.line, {bad.says});
}

TEST_F(CommandLine, SenselessObserversAreRefused) {
  for (const BadFile& bad : kNoObserver)
    expect_refused(std::string("render --epoch 2026-11-22 --pointing 1,2,3 --out x.fits --observer ") + bad.file,
                   {bad.says});
}

// A command that nobody wrote a bad line for would be a hole in this test.
TEST_F(CommandLine, EveryCommandIsTried) {
  std::set<std::string> tried;
  for (const Bad& bad : kBad) {
    const std::vector<std::string> line = words(bad.line);
    for (std::size_t n = 1; n <= std::min<std::size_t>(line.size(), 2); ++n)
      tried.insert(n == 1 ? line[0] : line[0] + " " + line[1]);
  }
  for (const std::string& command : testing::commands_of(ASTRONAV_PROGRAM, folder()))
    EXPECT_TRUE(tried.contains(command)) << command;
}

TEST_F(CommandLine, SeveralPicturesUnreadableCountsMoreThanUnmatchedMoreThanSolved) {
  ASSERT_EQ(astronav("render --epoch 2026-11-22 --pointing 1,2,3 --out blank.fits --max-v -2 --no-noise").status, 0);
  struct Case {
    const char* pictures;
    int status;
    std::vector<std::string> each;
  };
  const std::vector<Case> cases{
      {"frame.fits", 0, {"solved"}},
      {"frame.fits frame.png", 0, {"solved", "solved"}},
      {"blank.fits frame.fits", 3, {"no_match", "solved"}},
      {"blank.fits cut.png frame.fits", 2, {"no_match", "unreadable", "solved"}},
      {"missing.png empty folder mission.toml", 2, std::vector<std::string>(4, "unreadable")}};
  for (const Case& c : cases) {
    const Outcome got = astronav(std::string("solve --fov 15:25 --json ") + c.pictures);
    EXPECT_EQ(got.status, c.status) << c.pictures << got.err;
    std::vector<std::string> each;
    for (const auto& line : testing::lines_of(got.out)) {
      const auto json = nlohmann::json::parse(line, nullptr, false);
      ASSERT_TRUE(json.is_object()) << line;
      EXPECT_TRUE(json.contains("message")) << line;
      each.push_back(json.value("status", ""));
      EXPECT_EQ(json.value("image", ""), words(c.pictures)[each.size() - 1]);
    }
    EXPECT_EQ(each, c.each) << c.pictures;
  }
}

}  // namespace
}  // namespace astronav
